#include "board/converter.h"

#include <algorithm>
#include <cmath>

#include "hal/lf2407a/registers.h"

namespace omnislip {

void Converter::reset() {
    done_at_ = kNever;
    at_begin_ = true;
}

void Converter::start() {
    if (done_at_ != kNever)
        board_.fault("ADC started while a sequence runs");
    if (!at_begin_)
        board_.fault("ADC started without RST SEQ1: it would go on behind the last channel");
    if (board_.value(MAXCONV) > 7)
        board_.fault("sequencer 1 has eight conversions");
    const std::uint16_t control = board_.value(ADCTRL1);
    const int clocks = 2 * ((control >> 8 & 15) + 1) + 13;
    const int cycles = clocks * (control & ADCTRL1_CPS ? 2 : 1);
    done_at_ = board_.now() + board_.cycles((board_.value(MAXCONV) + 1) * cycles);
    board_.set_bits(ADCTRL2, ADCTRL2_SEQ1_BSY, true);
}

void Converter::start_from_event_manager(bool is_eva) {
    if (is_eva && (board_.value(ADCTRL2) & ADCTRL2_EVA_SOC_SEQ1))
        start();
}

void Converter::run() {
    for (int k = 0; k <= board_.value(MAXCONV); ++k) {
        const std::uint16_t select = board_.value(static_cast<std::uint16_t>(CHSELSEQ1 + k / 4));
        const double volt = board_.analog_v(select >> (4 * (k % 4)) & 15);
        const double code = std::floor(volt / kStep_v);
        const auto clipped = static_cast<std::uint16_t>(std::clamp(code, 0.0, 1023.0));
        board_.set(static_cast<std::uint16_t>(RESULT0 + k),
                   static_cast<std::uint16_t>(clipped << 6));
    }
    done_at_ = kNever;
    at_begin_ = false;
    board_.set_bits(ADCTRL2, ADCTRL2_SEQ1_BSY, false);
    board_.set_bits(ADCTRL2, ADCTRL2_INT_FLAG_SEQ1, true);
}

std::uint16_t Converter::read(std::uint16_t address) {
    if (address >= RESULT0 && address <= RESULT15 && done_at_ != kNever)
        board_.fault("result read while the sequence runs");
    return board_.value(address);
}

void Converter::written(std::uint16_t address, std::uint16_t value) {
    if (address == ADCTRL1 && (value & ADCTRL1_RESET)) {
        reset();
        board_.set(ADCTRL1, 0);
        board_.set(ADCTRL2, 0);
    } else if (address == ADCTRL1 && (value & 0x005F)) {
        board_.fault("only start-stop with two sequencers is modelled, no calibration");
    } else if (address == ADCTRL2) {
        if (value & 0x8C6D)
            board_.fault("only sequencer 1 without interrupt is modelled");
        if (value & ADCTRL2_RST_SEQ1)
            reset();
        board_.set_bits(ADCTRL2, ADCTRL2_RST_SEQ1 | ADCTRL2_SOC_SEQ1, false);
        if (value & ADCTRL2_RST_SEQ1)
            board_.set_bits(ADCTRL2, ADCTRL2_SEQ1_BSY, false);
        if (value & ADCTRL2_SOC_SEQ1)
            start();
    }
}

}  // namespace omnislip
