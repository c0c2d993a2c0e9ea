/* The virtual LF2407A as the carrier of a virtual robot. */
#include "board/on_board.h"
#include "board/own_thread.h"
#include "board/serial_port.h"
#include "board/spi_port.h"
#include "hal/hal.h"
#include "robot_carrier.h"

namespace omnislip {
namespace {

class BoardCarrier : public RobotCarrier {
  public:
    BoardCarrier(RobotBody &body, const std::vector<std::uint16_t> &store) {
        thread_.call([&] {
            on_board_ =
                std::make_unique<OnBoard<RobotBody>>(body, CountersMaker{}, Converter::kStep_v);
        });
        std::vector<std::uint8_t> &bytes = board().eeprom().bytes();
        for (std::size_t word = 0; word < store.size(); ++word) {
            bytes[2 * word] = static_cast<std::uint8_t>(store[word] >> 8);
            bytes[2 * word + 1] = static_cast<std::uint8_t>(store[word] & 0xFF);
        }
    }

    ~BoardCarrier() override {
        thread_.call([this] { on_board_.reset(); });
    }

    void with_hal(const std::function<void()> &work) override {
        thread_.call(work);
    }

    void start_tick() override {
        on_board_->wait_for_tick(0.0);
    }

    void run_to_tick(long next) override {
        on_board_->wait_for_tick(static_cast<double>(next) * kTick_s);
    }

    void send(const std::vector<std::uint8_t> &bytes) override {
        board().serial().send(bytes);
    }

    std::vector<std::uint8_t> take_received() override {
        return board().serial().take_received();
    }

    std::vector<std::uint16_t> store() const override {
        const std::vector<std::uint8_t> &bytes = board().eeprom().bytes();
        std::vector<std::uint16_t> words(HAL_STORE_WORDS);
        for (std::size_t word = 0; word < words.size(); ++word)
            words[word] = static_cast<std::uint16_t>(bytes[2 * word] << 8 | bytes[2 * word + 1]);
        return words;
    }

    long store_writes() const override {
        return board().eeprom().writes();
    }

  private:
    Board &board() const {
        return on_board_->board();
    }

    OwnThread thread_;
    std::unique_ptr<OnBoard<RobotBody>> on_board_;
};

}  // namespace

std::unique_ptr<RobotCarrier> carry_on_board(RobotBody &body,
                                             const std::vector<std::uint16_t> &store) {
    return std::make_unique<BoardCarrier>(body, store);
}

}  // namespace omnislip
