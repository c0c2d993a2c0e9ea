#include "board/board.h"

#include <algorithm>
#include <array>
#include <cstdio>

#include "board/converter.h"
#include "board/event_manager.h"
#include "board/serial_port.h"
#include "board/spi_port.h"
#include "hal/lf2407a/registers.h"
#include "hal/lf2407a/target.h"

namespace omnislip {
namespace {

struct RegisterInfo {
    const char *name;
    std::uint16_t address, clock, writable, flags, ones, status, reset;
};

#define BOARD_REGISTER(name, address, clock, writable, flags, ones, status, reset) \
    {#name, address, clock, writable, flags, ones, status, reset},
constexpr RegisterInfo kRegisters[] = {
#include "board/registers.def"
};
#undef BOARD_REGISTER

constexpr std::uint16_t kFirst = 0x7000, kEnd = 0x7600, kBus = 0x8000;

/* Position in kRegisters plus 1 of every address from 7000h; 0: undefined. */
constexpr std::array<std::uint8_t, kEnd - kFirst> make_index() {
    std::array<std::uint8_t, kEnd - kFirst> index = {};
    std::uint8_t position = 0;
    for (const RegisterInfo &info : kRegisters)
        index[info.address - kFirst] = ++position;
    return index;
}
constexpr auto kIndex = make_index();

const RegisterInfo *find(std::uint16_t address) {
    if (address < kFirst || address >= kEnd || kIndex[address - kFirst] == 0)
        return nullptr;
    return &kRegisters[kIndex[address - kFirst] - 1];
}

/* Sources of an INT level from the first served to the last (SPRU357, interrupt priority table). */
constexpr std::uint16_t kPriority[] = {0x20, 0x19, 0x04, 0x01, 0x11, 0x05, 0x06, 0x07, 0x27, 0x28,
                                       0x29, 0x2F, 0x30, 0x31, 0x2B, 0x2C, 0x2D, 0x39, 0x3A, 0x3B};

/* The flag that the routine of a source must have cleared. */
struct SourceFlag {
    std::uint16_t pivr, address, mask;
};
constexpr SourceFlag kSourceFlags[] = {
    {0x20, EVA + EVIFRA, 0x0001}, {0x19, EVB + EVIFRA, 0x0001}, {0x27, EVA + EVIFRA, 0x0080},
    {0x28, EVA + EVIFRA, 0x0100}, {0x29, EVA + EVIFRA, 0x0200}, {0x2B, EVA + EVIFRB, 0x0001},
    {0x2C, EVA + EVIFRB, 0x0002}, {0x2D, EVA + EVIFRB, 0x0004}, {0x2F, EVB + EVIFRA, 0x0080},
    {0x30, EVB + EVIFRA, 0x0100}, {0x31, EVB + EVIFRA, 0x0200}, {0x39, EVB + EVIFRB, 0x0001},
    {0x3A, EVB + EVIFRB, 0x0002}, {0x3B, EVB + EVIFRB, 0x0004}, {0x06, SCIRXST, SCIRXST_RXRDY}};

thread_local Board *attached = nullptr;

Board &current() {
    if (attached == nullptr)
        throw BoardFault("no virtual board is attached to this thread");
    return *attached;
}

std::string hex(unsigned value) {
    char text[8];
    std::snprintf(text, sizeof text, "%04Xh", value);
    return text;
}

bool is_event_manager(std::uint16_t address) {
    return address >= EVA && address < kEnd;
}

}  // namespace

Board::Board(BoardSurroundings &surroundings, BusDevice &bus, const BoardVectors &vectors)
    : surroundings_(surroundings),
      bus_(bus),
      vectors_(vectors),
      converter_(std::make_unique<Converter>(*this)),
      serial_(std::make_unique<SerialPort>(*this)),
      eeprom_(std::make_unique<Eeprom>(*this)),
      values_(kEnd - kFirst, 0) {
    spi_ = std::make_unique<SpiPort>(*this, *eeprom_);
    for (int i = 0; i < 2; ++i)
        event_managers_[static_cast<std::size_t>(i)] = std::make_unique<EventManager>(*this, i);
    reset(false);
}

Board::~Board() {
    if (attached == this)
        attached = nullptr;
}

void Board::attach() {
    attached = this;
}

void Board::reset(bool by_watchdog) {
    for (const RegisterInfo &info : kRegisters)
        set(info.address, info.reset);
    set_bits(WDCR, WDCR_WDFLAG, by_watchdog);
    for (auto &manager : event_managers_)
        manager->reset();
    converter_->reset();
    serial_->reset();
    spi_->reset();
    eeprom_->select(false);
    imr_ = ifr_ = 0;
    wsgr_ = 0x01FF;
    masked_ = true;
    imr_known_ = computing_ = second_key_ = false;
    requests_.clear();
    cycle_ = 8;
    restart_watchdog();
    drive();
    reschedule();
}

/* ---- registers as memory ---- */

std::uint16_t Board::value(std::uint16_t address) const {
    return values_[address - kFirst];
}

void Board::set(std::uint16_t address, std::uint16_t value) {
    values_[address - kFirst] = value;
}

void Board::set_bits(std::uint16_t address, std::uint16_t mask, bool on) {
    std::uint16_t &value = values_[address - kFirst];
    value = static_cast<std::uint16_t>(on ? value | mask : value & ~mask);
}

std::string Board::register_name(std::uint16_t address) {
    if (address == IMR)
        return "IMR";
    if (address == IFR)
        return "IFR";
    const RegisterInfo *info = find(address);
    return info ? info->name : hex(address);
}

void Board::fault(const std::string &rule) const {
    char at[40];
    std::snprintf(at, sizeof at, " at %.3f us: ", static_cast<double>(now_) * kBoardTime_s * 1e6);
    std::string text = last_write_ ? "write " : "read ";
    text += register_name(last_address_) + " (" + hex(last_address_) + ")";
    if (last_write_)
        text += " = " + hex(last_value_);
    throw BoardFault(text + at + rule);
}

void Board::note(std::uint16_t address, std::uint16_t value, bool write, bool io_space) {
    last_address_ = address;
    last_value_ = value;
    last_write_ = write;
    if (recording_)
        accesses_.push_back({now_, address, value, write, io_space});
}

/* ---- accesses ---- */

std::uint16_t Board::read(std::uint16_t address) {
    spend(kAccessCycles);
    note(address, 0, false, false);
    std::uint16_t result = 0;
    if (address >= kBus) {
        result = access_bus(address, false, 0);
    } else if (address == IMR || address == IFR) {
        result = address == IMR ? imr_ : ifr_;
    } else {
        const RegisterInfo *info = find(address);
        if (info == nullptr)
            fault("undefined or not modelled");
        if (info->clock && !(value(SCSR1) & info->clock))
            fault("the clock of this peripheral is off (SCSR1)");
        if (is_event_manager(address)) {
            result = event_managers_[address >= EVB]->read(address & 0xFF);
        } else if (address >= ADCTRL1 && address <= RESULT15) {
            result = converter_->read(address);
        } else if (address >= SCICCR && address <= SCIPRI) {
            result = serial_->read(address);
        } else if (address >= SPICCR && address <= SPIPRI) {
            result = spi_->read(address);
        } else {
            result = value(address);
        }
    }
    if (recording_)
        accesses_.back().value = result;
    return result;
}

void Board::check_write(std::uint16_t address, std::uint16_t value) {
    const RegisterInfo *info = find(address);
    if (info == nullptr)
        fault("undefined or not modelled");
    if (info->clock && !(this->value(SCSR1) & info->clock))
        fault("the clock of this peripheral is off (SCSR1): the chip ignores this");
    const unsigned known = info->writable | info->flags | info->status;
    if ((info->writable | info->flags) == 0)
        fault("read-only");
    if (value & ~known & (address == WDCR ? 0xFF00U : 0xFFFFU))
        fault("a reserved bit is written as 1");
    if ((value & info->ones) != info->ones)
        fault("a bit that must stay 1 is written as 0");
    const unsigned cleared = value & info->flags & this->value(address);
    if (info->writable == 0 && (cleared & (cleared - 1)))
        fault("clears several flags at once: a read-modify-write loses events");
}

void Board::write(std::uint16_t address, std::uint16_t value) {
    const bool compare =
        is_event_manager(address) && (address & 0xFF) >= ACTR && (address & 0xFF) <= CMPR3;
    if (compare && computing_) {
        computing_ = false;
        spend(compute_cycles_);
    }
    spend(kAccessCycles);
    note(address, value, true, false);
    if (address >= kBus) {
        access_bus(address, true, value);
    } else if (address == IMR || address == IFR) {
        write_core(address, value);
    } else {
        if (is_event_manager(address) && find(address))
            event_managers_[address >= EVB]->sync();
        check_write(address, value);
        const RegisterInfo *info = find(address);
        const std::uint16_t before = this->value(address);
        const unsigned kept = before & ~(info->writable | (value & info->flags));
        set(address, static_cast<std::uint16_t>(kept | (value & info->writable)));
        written(address, value, before);
    }
    reschedule();
    serve_interrupts();
}

void Board::written(std::uint16_t address, std::uint16_t value, std::uint16_t before) {
    if (is_event_manager(address)) {
        event_managers_[address >= EVB]->written(address & 0xFF, value);
    } else if (address >= ADCTRL1 && address <= RESULT15) {
        converter_->written(address, value);
    } else if (address >= SCICCR && address <= SCIPRI) {
        serial_->written(address, value);
    } else if (address >= SPICCR && address <= SPIPRI) {
        spi_->written(address, value);
    } else if (address >= WDCNTR && address <= WDCR) {
        write_watchdog(address, value);
    } else if (address == SCSR1) {
        const BoardTime cycle = ((value & SCSR1_CLKPS) >> 9) + 1;
        watchdog_at_ = now_ + (watchdog_at_ - now_) / cycle_ * cycle;
        cycle_ = cycle;
    } else if (address == SCSR2) {
        /* Writing 1 to the watchdog's override clears it, 0 leaves it. */
        const bool stays = (before & SCSR2_WD_OVERRIDE) && !(value & SCSR2_WD_OVERRIDE);
        set_bits(SCSR2, SCSR2_WD_OVERRIDE, stays);
    } else if (address == PCDATDIR && !(this->value(MCRB) & 0x0020)) {
        /* The EEPROM's select has a pull-up. */
        eeprom_->select((value & PCDATDIR_IOPC5_OUTPUT) && !(value & PCDATDIR_IOPC5));
    } else if (address == MCRA || address == MCRC) {
        drive();
    }
}

void Board::write_core(std::uint16_t address, std::uint16_t value) {
    if (value & ~ALL_INT_BITS)
        fault("a reserved bit is written as 1");
    if (address == IMR) {
        imr_ = value;
        imr_known_ = true;
    } else {
        ifr_ = static_cast<std::uint16_t>(ifr_ & ~value);
    }
}

void Board::write_wsgr(std::uint16_t value) {
    spend(kAccessCycles);
    note(WSGR, value, true, true);
    if (value & 0xF800)
        fault("a reserved bit is written as 1");
    wsgr_ = value;
}

std::uint16_t Board::access_bus(std::uint16_t address, bool write, std::uint16_t value) {
    const int wait_states = wsgr_ >> WSGR_DATA_SHIFT & 7;
    if (this->value(SCSR2) & SCSR2_XMIF_HI_Z)
        fault("the external bus is not driven (SCSR2, XMIF HI-Z)");
    if (wait_states < bus_.wait_states())
        fault("the device needs " + std::to_string(bus_.wait_states()) +
              " wait states, WSGR gives " + std::to_string(wait_states));
    spend(wait_states);
    const auto offset = static_cast<std::uint16_t>(address - kBus);
    try {
        if (write) {
            bus_.write(offset, value, now_);
            return 0;
        }
        computing_ = true;
        return bus_.read(offset, now_);
    } catch (const BoardFault &device) {
        fault(device.what());
    }
}

/* ---- watchdog ---- */

void Board::restart_watchdog() {
    const std::uint16_t control = value(WDCR);
    const int select = control & WDCR_WDPS;
    const std::int64_t prescale = select < 2 ? 1 : 1 << (select - 1);
    const bool off = (control & WDCR_WDDIS) && (value(SCSR2) & SCSR2_WD_OVERRIDE);
    watchdog_at_ = off ? kNever : now_ + cycles(256 * 512 * prescale);
}

void Board::write_watchdog(std::uint16_t address, std::uint16_t value) {
    if (address == WDCR) {
        if ((value & 0x0038) != WDCR_CHECK)
            throw BoardReset{true};
        set_bits(WDCR, 0x0038, false);
        restart_watchdog();
    } else if (address == WDKEY) {
        if (value != WDKEY_FIRST && value != WDKEY_SECOND)
            throw BoardReset{true};
        if (value == WDKEY_SECOND && second_key_)
            restart_watchdog();
        second_key_ = value == WDKEY_FIRST;
    }
}

/* ---- time and interrupts ---- */

void Board::reschedule() {
    next_event_ =
        std::min({converter_->next_event(), serial_->next_event(), spi_->next_event(), watchdog_at_,
                  event_managers_[0]->next_event(), event_managers_[1]->next_event()});
}

void Board::run_to(BoardTime target) {
    while (next_event_ <= target) {
        now_ = std::max(now_, next_event_);
        if (watchdog_at_ <= now_)
            throw BoardReset{true};
        for (auto &manager : event_managers_) {
            if (manager->next_event() <= now_)
                manager->run();
        }
        if (converter_->next_event() <= now_)
            converter_->run();
        if (serial_->next_event() <= now_)
            serial_->run();
        if (spi_->next_event() <= now_)
            spi_->run();
        reschedule();
    }
    now_ = target;
}

/* Interrupts come when they are due and lengthen it. */
void Board::spend(int count) {
    BoardTime left = cycles(count);
    while (left > 0) {
        const BoardTime end = now_ + left;
        const BoardTime stop = masked_ ? end : std::min(end, std::max(next_event_, now_));
        left -= stop - now_;
        run_to(stop);
        serve_interrupts();
    }
}

void Board::serve_interrupts() {
    while (!masked_ && serve_interrupt()) {
    }
}

void Board::wait() {
    while (masked_ || !serve_interrupt()) {
        if (now_ >= horizon_)
            return;
        run_to(std::min(next_event_, horizon_));
    }
}

void Board::mask_interrupts(bool masked) {
    if (!masked && !imr_known_)
        throw BoardFault("interrupts are let in before IMR is written: reset leaves it undefined");
    masked_ = masked;
    spend(1);
}

void Board::request(int level, std::uint16_t pivr) {
    const auto *place = std::find(std::begin(kPriority), std::end(kPriority), pivr);
    requests_.push_back({level, pivr, static_cast<int>(place - kPriority)});
    ifr_ = static_cast<std::uint16_t>(ifr_ | 1U << (level - 1));
}

bool Board::serve_interrupt() {
    const unsigned pending = imr_ & ifr_;
    if (pending == 0)
        return false;
    int level = 1;
    while (!(pending >> (level - 1) & 1U))
        ++level;
    const BoardTime begin = now_;
    masked_ = true;
    run_to(now_ + cycles(kEnterCycles));
    ifr_ = static_cast<std::uint16_t>(ifr_ & ~(1U << (level - 1)));
    auto chosen = requests_.end();
    for (auto it = requests_.begin(); it != requests_.end(); ++it) {
        if (it->level == level && (chosen == requests_.end() || it->rank < chosen->rank))
            chosen = it;
    }
    const std::uint16_t pivr = chosen == requests_.end() ? PIVR_PHANTOM : chosen->pivr;
    if (chosen != requests_.end())
        requests_.erase(chosen);
    for (const Request &left : requests_) {
        if (left.level == level)
            ifr_ = static_cast<std::uint16_t>(ifr_ | 1U << (level - 1));
    }
    set(PIVR, pivr);
    const std::size_t index = static_cast<std::size_t>(level - 1);
    if (vectors_[index] == nullptr)
        throw BoardFault("INT" + std::to_string(level) + " has no routine");
    vectors_[index]();
    check_served(level, pivr);
    run_to(now_ + cycles(kLeaveCycles));
    masked_ = false;
    ++interrupts_[index];
    interrupt_cycles_[index] += (now_ - begin) / cycle_;
    return true;
}

void Board::check_served(int level, std::uint16_t pivr) {
    for (const SourceFlag &source : kSourceFlags) {
        if (source.pivr != pivr || !(value(source.address) & source.mask))
            continue;
        /* It may have risen again meanwhile. */
        for (const Request &request : requests_) {
            if (request.pivr == pivr)
                return;
        }
        throw BoardFault("the routine of INT" + std::to_string(level) + " left the flag in " +
                         register_name(source.address) +
                         " set: the chip will not request this interrupt again");
    }
}

/* ---- pins ---- */

void Board::set_protection_pin(int event_manager, bool high) {
    event_managers_[static_cast<std::size_t>(event_manager)]->sync();
    event_managers_[static_cast<std::size_t>(event_manager)]->set_protection_pin(high);
    reschedule();
}

void Board::start_conversion(bool from_eva) {
    converter_->start_from_event_manager(from_eva);
}

void Board::drive() {
    if (event_managers_[1] == nullptr)
        return;
    const std::array<double, 4> duty = {
        event_managers_[0]->bridge(0), event_managers_[0]->bridge(1), event_managers_[1]->bridge(0),
        event_managers_[1]->bridge(1)};
    if (duty != duty_) {
        duty_ = duty;
        surroundings_.drive(duty, now_);
    }
}

double Board::analog_v(int channel) {
    return surroundings_.analog_v(channel, now_);
}

bool Board::serial_pins() const {
    return (value(MCRA) & MCRA_SCI) == MCRA_SCI;
}

bool Board::spi_pins() const {
    return (value(MCRB) & MCRB_SPI) == MCRB_SPI;
}

bool Board::pwm_pin(int event_manager, int pin) const {
    return event_manager == 0 ? value(MCRA) >> (6 + pin) & 1 : value(MCRC) >> (1 + pin) & 1;
}

}  // namespace omnislip

/* ---- what the drivers call (hal/lf2407a/target.h) ---- */

extern "C" {
u16 virtual_board_read(u16 address) {
    return omnislip::current().read(address);
}
void virtual_board_write(u16 address, u16 value) {
    omnislip::current().write(address, value);
}
void virtual_board_write_wsgr(u16 value) {
    omnislip::current().write_wsgr(value);
}
void virtual_board_mask_interrupts(int masked) {
    omnislip::current().mask_interrupts(masked != 0);
}
void virtual_board_wait(void) {
    omnislip::current().wait();
}
}
