/* own_thread.h - a thread that does what it is given, one thing after the other.
 *
 * The state of the drivers and the attachments of board and HAL belong to a thread. A board that
 * lives on a thread of its own can be used from any other, and beside other boards. */
#ifndef OMNISLIP_SIM_BOARD_OWN_THREAD_H
#define OMNISLIP_SIM_BOARD_OWN_THREAD_H

#include <condition_variable>
#include <functional>
#include <future>
#include <mutex>
#include <thread>

namespace omnislip {

class OwnThread {
  public:
    OwnThread() : thread_([this] { serve(); }) {}

    ~OwnThread() {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            ending_ = true;
        }
        given_.notify_one();
        thread_.join();
    }

    OwnThread(const OwnThread &) = delete;
    OwnThread &operator=(const OwnThread &) = delete;

    /* Returns when `work` is done; what it throws is thrown here. One caller at a time. */
    void call(const std::function<void()> &work) {
        std::packaged_task<void()> task(work);
        std::future<void> done = task.get_future();
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            task_ = std::move(task);
        }
        given_.notify_one();
        done.get();
    }

  private:
    void serve() {
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            given_.wait(lock, [this] { return ending_ || task_.valid(); });
            if (!task_.valid())
                return;
            std::packaged_task<void()> task = std::move(task_);
            task();
        }
    }

    std::mutex mutex_;
    std::condition_variable given_;
    std::packaged_task<void()> task_;
    bool ending_ = false;
    std::thread thread_; /* last: it uses the others */
};

}  // namespace omnislip

#endif
