/* A thread that does what it is given: all on the same one, failures come back to the caller. */
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "board/own_thread.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

using omnislip::OwnThread;

extern "C" void setUp(void) {}
extern "C" void tearDown(void) {}

static thread_local int counted = 0;

static void state_of_a_thread_is_kept_from_call_to_call(void) {
    OwnThread first, second;
    std::vector<int> seen;
    for (int k = 0; k < 3; ++k)
        first.call([&] { seen.push_back(++counted); });
    second.call([&] { seen.push_back(++counted); });
    const std::vector<int> expected = {1, 2, 3, 1};
    TEST_ASSERT_TRUE(seen == expected);
    TEST_ASSERT_EQUAL(0, counted);
}

static void callers_may_be_different_threads(void) {
    OwnThread own;
    std::thread::id here, there;
    own.call([&] { here = std::this_thread::get_id(); });
    std::thread caller([&] { own.call([&] { there = std::this_thread::get_id(); }); });
    caller.join();
    TEST_ASSERT_TRUE(here == there);
    TEST_ASSERT_TRUE(here != std::this_thread::get_id());
}

static void what_is_thrown_there_is_thrown_here_and_it_goes_on(void) {
    OwnThread own;
    std::string caught;
    try {
        own.call([] { throw std::runtime_error("the watchdog has reset"); });
    } catch (const std::runtime_error &error) {
        caught = error.what();
    }
    TEST_ASSERT_EQUAL_STRING("the watchdog has reset", caught.c_str());
    bool done = false;
    own.call([&] { done = true; });
    TEST_ASSERT_TRUE(done);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(state_of_a_thread_is_kept_from_call_to_call);
    RUN_TEST(callers_may_be_different_threads);
    RUN_TEST(what_is_thrown_there_is_thrown_here_and_it_goes_on);
    return UNITY_END();
}
