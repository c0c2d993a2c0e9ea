#include "board/event_manager.h"

#include <algorithm>

#include "hal/lf2407a/registers.h"

namespace omnislip {
namespace {

constexpr std::uint16_t kTimerOffset[2] = {T1CNT, T2CNT};
constexpr int kCon = 3, kPr = 2, kCmpr = 1, kCnt = 0;
/* Flag of (timer, kind) in EVIFRA for T1, EVIFRB for T2, and its PIVR in EVA and EVB. */
constexpr std::uint16_t kFlag[2][3] = {{0x0100, 0x0080, 0x0200}, {0x0002, 0x0001, 0x0004}};
constexpr std::uint16_t kVector[2][2][3] = {{{0x28, 0x27, 0x29}, {0x2C, 0x2B, 0x2D}},
                                            {{0x30, 0x2F, 0x31}, {0x3A, 0x39, 0x3B}}};
constexpr std::uint16_t kFlagOffset[2] = {EVIFRA, EVIFRB};
constexpr std::uint16_t kMaskOffset[2] = {EVIMRA, EVIMRB};
constexpr std::uint16_t kCompareFlags = 0x000E;

}  // namespace

EventManager::EventManager(Board &board, int index) : board_(board), index_(index) {
    reset();
}

void EventManager::reset() {
    timers_[0] = Timer();
    timers_[1] = Timer();
    std::fill(compare_, compare_ + 3, 0);
    actions_ = 0;
    raised_[0] = raised_[1] = 0;
    synced_ = board_.now();
}

std::uint16_t EventManager::value(std::uint16_t offset) const {
    return board_.value(static_cast<std::uint16_t>(base() + offset));
}

/* ---- timers ---- */

std::int64_t EventManager::length(const Timer &timer) {
    return timer.up_down ? std::max<std::int64_t>(2 * timer.period, 1) : timer.period + 1;
}

std::int64_t EventManager::phase(const Timer &timer) const {
    return (board_.now() - timer.origin) / timer.step % length(timer);
}

std::int64_t EventManager::count(const Timer &timer) const {
    if (!timer.running)
        return timer.held;
    const std::int64_t p = phase(timer);
    return timer.up_down && p > timer.period ? 2 * timer.period - p : p;
}

/* First instant of the kind that is later than `after`. */
BoardTime EventManager::next(const Timer &timer, Kind kind, BoardTime after) {
    if (!timer.running || (kind == kCompare && timer.compare > timer.period))
        return kNever;
    const std::int64_t cycle = length(timer) * timer.step;
    const auto at = [&](std::int64_t phase) {
        const BoardTime first = timer.origin + phase * timer.step;
        if (first > after)
            return first;
        return first + ((after - first) / cycle + 1) * cycle;
    };
    if (kind == kUnderflow)
        return at(0);
    if (kind == kPeriod)
        return at(timer.period);
    if (timer.up_down)
        return std::min(at(timer.compare), at(2 * timer.period - timer.compare));
    return at(timer.compare);
}

void EventManager::control(int index, std::uint16_t control) {
    Timer &timer = timers_[index];
    const int mode = control >> 11 & 3;
    if (mode == 3)
        board_.fault("directional counting is not modelled");
    if (control & 0x0030)
        board_.fault("only the internal clock of a timer is modelled");
    if (index == 1 && (control & 0x0081))
        board_.fault("T2 with the enable or the period of T1 is not modelled");
    const std::int64_t held = count(timer);
    timer.up_down = mode == 1;
    timer.step = board_.cycles(1) << (control >> 8 & 7);
    timer.running = (control & TCON_ENABLE) && mode != 0;
    timer.held = held;
    timer.origin = board_.now() - held * timer.step;
}

/* What TxPR and TxCMPR hold takes effect. */
void EventManager::load_timer(int index) {
    Timer &timer = timers_[index];
    const std::uint16_t offset = kTimerOffset[index];
    if (timer.running && value(offset + kPr) != timer.period)
        timer.origin = board_.now();
    timer.period = value(offset + kPr);
    timer.compare = value(offset + kCmpr);
}

/* What CMPRx and ACTR hold reaches the pins. */
void EventManager::load_units() {
    for (int unit = 0; unit < 3; ++unit)
        compare_[unit] = value(static_cast<std::uint16_t>(CMPR1 + unit));
    actions_ = value(ACTR);
    board_.drive();
}

bool EventManager::waits_for_load(int index) const {
    const Timer &timer = timers_[index];
    const std::uint16_t offset = kTimerOffset[index];
    bool waits = value(offset + kPr) != timer.period || value(offset + kCmpr) != timer.compare;
    if (index == 0) {
        for (int unit = 0; unit < 3; ++unit)
            waits |= value(static_cast<std::uint16_t>(CMPR1 + unit)) != compare_[unit];
        waits |= value(ACTR) != actions_;
    }
    return waits;
}

bool EventManager::starts_converter(int index, Kind kind) const {
    constexpr int code[3] = {3, 2, 1};
    return (value(GPTCON) >> (index == 0 ? 7 : 9) & 3) == code[kind];
}

/* Somebody must be told at that instant: an enabled interrupt that is not pending, the converter.
 */
bool EventManager::wants(int index, Kind kind) const {
    const std::uint16_t flag = kFlag[index][kind];
    return starts_converter(index, kind) ||
           (value(kMaskOffset[index]) & ~value(kFlagOffset[index]) & flag);
}

BoardTime EventManager::next_event() const {
    BoardTime first = kNever;
    for (int index = 0; index < 2; ++index) {
        for (Kind kind : {kCompare, kPeriod, kUnderflow}) {
            if (wants(index, kind) || (kind == kUnderflow && waits_for_load(index)))
                first = std::min(first, next(timers_[index], kind, synced_));
        }
    }
    return first;
}

void EventManager::sync() {
    const BoardTime now = board_.now();
    for (int index = 0; index < 2; ++index) {
        for (Kind kind : {kCompare, kPeriod, kUnderflow}) {
            if (next(timers_[index], kind, synced_) > now)
                continue;
            const std::uint16_t offset = static_cast<std::uint16_t>(base() + kFlagOffset[index]);
            board_.set_bits(offset, kFlag[index][kind], true);
            if (starts_converter(index, kind))
                board_.start_conversion(index_ == 0);
        }
    }
    synced_ = now;
    raise();
}

void EventManager::run() {
    const BoardTime now = board_.now();
    bool underflow[2];
    for (int index = 0; index < 2; ++index)
        underflow[index] = next(timers_[index], kUnderflow, now - 1) == now;
    sync();
    for (int index = 0; index < 2; ++index) {
        if (underflow[index])
            load_timer(index);
    }
    if (underflow[0])
        load_units();
}

/* A flag that is set and enabled requests its interrupt once. */
void EventManager::raise() {
    for (int index = 0; index < 2; ++index) {
        const std::uint16_t level = value(kFlagOffset[index]) & value(kMaskOffset[index]);
        const std::uint16_t rising = level & ~raised_[index];
        raised_[index] = level;
        if (index == 0 && (rising & EVA_PDPINT))
            board_.request(1, index_ == 0 ? 0x20 : 0x19);
        for (Kind kind : {kCompare, kPeriod, kUnderflow}) {
            if (rising & kFlag[index][kind])
                board_.request(2 + index, kVector[index_][index][kind]);
        }
    }
}

/* ---- registers ---- */

std::uint16_t EventManager::read(std::uint16_t offset) {
    sync();
    std::uint16_t result = value(offset);
    if (offset == T1CNT || offset == T2CNT)
        return static_cast<std::uint16_t>(count(timers_[offset == T2CNT]));
    if (offset == GPTCON) {
        result &= 0x07CF;
        for (int index = 0; index < 2; ++index) {
            const Timer &timer = timers_[index];
            const bool down = timer.running && timer.up_down && phase(timer) >= timer.period;
            result |= down ? 0 : 0x2000 << index;
        }
    } else if (offset == COMCON) {
        result =
            static_cast<std::uint16_t>((result & ~COMCON_PDPINT) | (pin_high_ ? COMCON_PDPINT : 0));
    }
    return result;
}

void EventManager::written(std::uint16_t offset, std::uint16_t value) {
    sync();
    for (int index = 0; index < 2; ++index) {
        Timer &timer = timers_[index];
        if (offset == kTimerOffset[index] + kCon)
            control(index, value);
        if (offset == kTimerOffset[index] + kCnt) {
            timer.held = value;
            timer.origin = board_.now() - value * timer.step;
        }
        if (!timer.running && offset >= kTimerOffset[index] && offset <= kTimerOffset[index] + kPr)
            load_timer(index);
    }
    if (offset == EVIMRA && (value & kCompareFlags))
        board_.fault("interrupts of the compare units are not modelled");
    if (offset == COMCON && (value & 0x7C00))
        board_.fault("only loads at underflow and no space vectors are modelled");
    if (offset == COMCON && !pin_high_)
        board_.set_bits(static_cast<std::uint16_t>(base() + COMCON), COMCON_FCOMPOE, false);
    if (!(this->value(COMCON) & COMCON_CENABLE))
        load_units();
    raise();
    board_.drive();
}

void EventManager::set_protection_pin(bool high) {
    if (pin_high_ && !high && (value(EVIMRA) & EVA_PDPINT)) {
        board_.set_bits(static_cast<std::uint16_t>(base() + COMCON), COMCON_FCOMPOE, false);
        board_.set_bits(static_cast<std::uint16_t>(base() + GPTCON), 0x0040, false);
        board_.set_bits(static_cast<std::uint16_t>(base() + EVIFRA), EVA_PDPINT, true);
    }
    pin_high_ = high;
    raise();
    board_.drive();
}

/* ---- pins ---- */

bool EventManager::outputs_on() const {
    const std::uint16_t clock = index_ == 0 ? SCSR1_EVA : SCSR1_EVB;
    return (board_.value(SCSR1) & clock) && (value(COMCON) & COMCON_FCOMPOE);
}

/* Share of the period that the wave of a unit is 1, after dead time. */
double EventManager::active_fraction(int unit, bool second) const {
    const Timer &timer = timers_[0];
    const std::int64_t match = compare_[unit];
    if (!timer.running)
        return timer.held >= match ? 1.0 : 0.0;
    const double whole = static_cast<double>(length(timer));
    if (match == 0)
        return 1.0;
    if (match > timer.period || (timer.up_down && match == timer.period))
        return 0.0;
    const std::int64_t on = timer.up_down ? 2 * (timer.period - match) : timer.period + 1 - match;
    const std::uint16_t dead_band = value(DBTCON);
    double dead = 0.0;
    if (dead_band >> (5 + unit) & 1) {
        const int cycles = (dead_band >> 8 & 15) << (dead_band >> 2 & 7);
        dead = static_cast<double>(board_.cycles(cycles)) / static_cast<double>(timer.step);
    }
    const double active = static_cast<double>(on) + (second ? dead : -dead);
    return std::clamp(active / whole, 0.0, 1.0);
}

double EventManager::high_fraction(int pin) const {
    if (!outputs_on() || !board_.pwm_pin(index_, pin))
        return 0.0;
    const int action = actions_ >> (2 * pin) & 3;
    if (action == 0 || action == 3)
        return action == 3 ? 1.0 : 0.0;
    const double active = active_fraction(pin / 2, pin % 2 == 1);
    return action == 2 ? active : 1.0 - active;
}

double EventManager::bridge(int unit) const {
    return high_fraction(2 * unit) - high_fraction(2 * unit + 1);
}

}  // namespace omnislip
