/* board.h - virtual TMS320LF2407A at register level: runs the drivers of hal/lf2407a on a PC.
 *
 * The drivers are compiled with OMNISLIP_VIRTUAL_BOARD and reach this board by every register
 * access (hal/lf2407a/target.h). Time moves only there and in CPU_WAIT:
 *
 *     an access costs kAccessCycles of CLKOUT, on the external bus its wait states besides;
 *     an interrupt kEnterCycles before and kLeaveCycles after its routine;
 *     what the firmware computes between reading the counters and writing the first action or
 *     compare register costs `compute_cycles`; all other code is free.
 *
 * Between accesses the board goes from event to event (compare loads, bytes, conversions, enabled
 * interrupts), so an idle millisecond costs next to nothing. Peripherals are described at their
 * classes; an unknown combination of bits is refused, not guessed.
 *
 * What a chip would punish by silence, a wrong value or a burnt bridge ends here with an exception
 * that names address, value, time and rule (BoardFault). What resets the chip throws BoardReset.
 *
 * Sources: addresses, layouts and codes as in hal/lf2407a/registers.h. The behaviour marked [M]
 * there and in the classes is from memory of SPRU357 and unverified.
 */
#ifndef OMNISLIP_SIM_BOARD_BOARD_H
#define OMNISLIP_SIM_BOARD_BOARD_H

#include <array>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace omnislip {

/* 25 ns, one CLKOUT cycle at 40 MHz. */
using BoardTime = std::int64_t;
constexpr double kBoardTime_s = 25e-9;
constexpr BoardTime kTickOfBoard = 40000;
constexpr BoardTime kNever = INT64_MAX;

constexpr int kAccessCycles = 6;
constexpr int kEnterCycles = 45;
constexpr int kLeaveCycles = 35;

struct BoardFault : std::logic_error {
    using std::logic_error::logic_error;
};
struct BoardReset {
    bool by_watchdog;
};

/* What is soldered to the chip. Times are those of the call and never run backwards. */
class BoardSurroundings {
  public:
    virtual ~BoardSurroundings() = default;
    /* Mean voltage over supply voltage of the four motors, from `now` on. */
    virtual void drive(const std::array<double, 4> &duty, BoardTime now) = 0;
    /* Voltage at the pin ADCIN`channel`. */
    virtual double analog_v(int channel, BoardTime now) = 0;
};

/* A device on the external bus; offsets count from 8000h. */
class BusDevice {
  public:
    virtual ~BusDevice() = default;
    virtual int wait_states() const = 0;
    virtual std::uint16_t read(std::uint16_t offset, BoardTime now) = 0;
    virtual void write(std::uint16_t offset, std::uint16_t value, BoardTime now) = 0;
};

/* Interrupt service routines of INT1..INT6, nullptr where the vector table has the trap. */
using BoardVectors = std::array<void (*)(), 6>;

struct BoardAccess {
    BoardTime time;
    std::uint16_t address;
    std::uint16_t value;
    bool write, io_space;
};

class EventManager;
class Converter;
class SerialPort;
class SpiPort;
class Eeprom;

class Board {
  public:
    Board(BoardSurroundings &surroundings, BusDevice &bus, const BoardVectors &vectors);
    ~Board();
    Board(const Board &) = delete;
    Board &operator=(const Board &) = delete;

    /* This thread's drivers run on this board until another one is attached. */
    void attach();
    /* Registers as after power-on or after a reset; time and EEPROM go on. */
    void reset(bool by_watchdog);

    /* ---- what the CPU does ---- */
    std::uint16_t read(std::uint16_t address);
    void write(std::uint16_t address, std::uint16_t value);
    void write_wsgr(std::uint16_t value);
    void mask_interrupts(bool masked);
    /* Until an interrupt was served or the horizon is reached. */
    void wait();
    void spend(int cycles);

    /* ---- what the outside does ---- */
    BoardTime now() const {
        return now_;
    }
    void set_horizon(BoardTime time) {
        horizon_ = time;
    }
    void set_compute_cycles(int cycles) {
        compute_cycles_ = cycles;
    }
    /* Level of PDPINTA (0) or PDPINTB (1). */
    void set_protection_pin(int event_manager, bool high);
    SerialPort &serial() {
        return *serial_;
    }
    Eeprom &eeprom() {
        return *eeprom_;
    }
    void record_accesses(bool on) {
        recording_ = on;
    }
    const std::vector<BoardAccess> &accesses() const {
        return accesses_;
    }
    static std::string register_name(std::uint16_t address);
    /* Cycles spent in the routine of INTn, entry and exit included. */
    BoardTime interrupt_cycles(int level) const {
        return interrupt_cycles_[static_cast<std::size_t>(level - 1)];
    }
    long interrupts(int level) const {
        return interrupts_[static_cast<std::size_t>(level - 1)];
    }

    /* ---- what the peripherals do ---- */
    std::uint16_t value(std::uint16_t address) const;
    void set(std::uint16_t address, std::uint16_t value);
    void set_bits(std::uint16_t address, std::uint16_t mask, bool on);
    BoardTime cycles(std::int64_t count) const {
        return count * cycle_;
    }
    /* A request of the source with this PIVR value, at its INT level. */
    void request(int level, std::uint16_t pivr);
    void start_conversion(bool from_event_manager);
    void drive();
    /* Somebody changed what will happen next. */
    void reschedule();
    double analog_v(int channel);
    bool serial_pins() const;
    bool spi_pins() const;
    bool pwm_pin(int event_manager, int pin) const;
    [[noreturn]] void fault(const std::string &rule) const;

  private:
    struct Request {
        int level;
        std::uint16_t pivr;
        int rank;
    };
    void check_write(std::uint16_t address, std::uint16_t value);
    void written(std::uint16_t address, std::uint16_t value, std::uint16_t before);
    void write_core(std::uint16_t address, std::uint16_t value);
    void write_watchdog(std::uint16_t address, std::uint16_t value);
    void restart_watchdog();
    std::uint16_t access_bus(std::uint16_t address, bool write, std::uint16_t value);
    void note(std::uint16_t address, std::uint16_t value, bool write, bool io_space);
    void run_to(BoardTime target);
    bool serve_interrupt();
    void serve_interrupts();
    void check_served(int level, std::uint16_t pivr);

    BoardSurroundings &surroundings_;
    BusDevice &bus_;
    BoardVectors vectors_;
    std::array<std::unique_ptr<EventManager>, 2> event_managers_;
    std::unique_ptr<Converter> converter_;
    std::unique_ptr<SerialPort> serial_;
    std::unique_ptr<SpiPort> spi_;
    std::unique_ptr<Eeprom> eeprom_;

    std::vector<std::uint16_t> values_;
    BoardTime now_ = 0, next_event_ = kNever, horizon_ = kNever;
    BoardTime cycle_ = 8, watchdog_at_ = kNever;
    std::uint16_t imr_ = 0, ifr_ = 0, wsgr_ = 0x01FF;
    bool masked_ = true, imr_known_ = false, computing_ = false, second_key_ = false;
    int compute_cycles_ = 8000;
    std::vector<Request> requests_;
    std::array<double, 4> duty_ = {};
    std::array<bool, 2> protection_high_ = {true, true};
    bool recording_ = false;
    std::vector<BoardAccess> accesses_;
    std::array<BoardTime, 6> interrupt_cycles_ = {};
    std::array<long, 6> interrupts_ = {};
    std::uint16_t last_address_ = 0, last_value_ = 0;
    bool last_write_ = false;
};

}  // namespace omnislip

#endif
