/* event_manager.h - EVA or EVB of the virtual board: two timers, three full compare units, PDPINT.
 *
 * A timer is its origin in time, its period and its prescaler; counts, flags and events are worked
 * out from these when somebody asks, so a running timer costs nothing.
 *
 *     up        0..PR, length PR + 1      wave of a unit: 0 until CMPR, then 1
 *     up/down   0..PR..0, length 2 PR     wave 1 between the two matches
 *     CMPR = 0: always 1; CMPR > PR (up) or >= PR (up/down): always 0 [M]
 *
 * Two bits of ACTR make a pin of the wave: 0 low, 1 inverted, 2 as it is, 3 high. Dead time delays
 * the rise of the first pin's wave and the fall of the second's. CMPR, ACTR, TxPR and TxCMPR are
 * shadowed; with CENABLE = 0 the first two are transparent [M]. An output is high-impedance, here:
 * pulled low, while FCOMPOE is 0, after reset, or after PDPINT fell while it is unmasked; that
 * clears FCOMPOE, and a write of it has no effect until the pin is high [M].
 *
 * Not modelled, and refused: directional counting, clocks other than internal, compare interrupts,
 * space vectors.
 */
#ifndef OMNISLIP_SIM_BOARD_EVENT_MANAGER_H
#define OMNISLIP_SIM_BOARD_EVENT_MANAGER_H

#include "board/board.h"

namespace omnislip {

class EventManager {
  public:
    EventManager(Board &board, int index);
    void reset();
    std::uint16_t read(std::uint16_t offset);
    void written(std::uint16_t offset, std::uint16_t value);
    /* Before a write of a flag register: sets what happened up to now. */
    void sync();
    BoardTime next_event() const;
    void run();
    void set_protection_pin(bool high);
    /* Mean voltage over supply voltage of the bridge behind pins 2 unit and 2 unit + 1. */
    double bridge(int unit) const;
    /* Fraction of the period that a pin 0..5 is high. */
    double high_fraction(int pin) const;

  private:
    enum Kind { kCompare, kPeriod, kUnderflow };
    struct Timer {
        bool running = false, up_down = false;
        BoardTime origin = 0, step = 1;
        std::int64_t held = 0, period = 0, compare = 0;
    };
    std::uint16_t base() const {
        return index_ == 0 ? 0x7400 : 0x7500;
    }
    std::uint16_t value(std::uint16_t offset) const;
    static std::int64_t length(const Timer &timer);
    std::int64_t phase(const Timer &timer) const;
    std::int64_t count(const Timer &timer) const;
    static BoardTime next(const Timer &timer, Kind kind, BoardTime after);
    void control(int timer, std::uint16_t control);
    void load_timer(int timer);
    void load_units();
    bool waits_for_load(int timer) const;
    bool starts_converter(int timer, Kind kind) const;
    bool wants(int timer, Kind kind) const;
    void raise();
    bool outputs_on() const;
    double active_fraction(int unit, bool second) const;

    Board &board_;
    int index_;
    Timer timers_[2];
    std::int64_t compare_[3] = {};
    std::uint16_t actions_ = 0;
    bool pin_high_ = true;
    BoardTime synced_ = 0;
    std::uint16_t raised_[2] = {};
};

}  // namespace omnislip

#endif
