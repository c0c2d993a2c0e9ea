/* converter.h - ADC of the virtual board: sequencer 1, 10 bits, 3.3 V.
 *
 * A start converts MAXCONV + 1 channels of CHSELSEQ1.. in turn and leaves the sequencer behind the
 * last: another start without RST SEQ1 would go on from there, and is refused. A channel takes
 * 2 (ACQ PS + 1) + 13 ADC clocks [M]; the whole sequence is sampled when it ends. Results lie in
 * bits 15..6 [M]. A start while one runs, and a result read meanwhile, are refused.
 */
#ifndef OMNISLIP_SIM_BOARD_CONVERTER_H
#define OMNISLIP_SIM_BOARD_CONVERTER_H

#include "board/board.h"

namespace omnislip {

class Converter {
  public:
    static constexpr double kFullScale_v = 3.3, kStep_v = kFullScale_v / 1024;

    explicit Converter(Board &board) : board_(board) {}
    void reset();
    std::uint16_t read(std::uint16_t address);
    void written(std::uint16_t address, std::uint16_t value);
    void start_from_event_manager(bool is_eva);
    BoardTime next_event() const {
        return done_at_;
    }
    void run();

  private:
    void start();

    Board &board_;
    BoardTime done_at_ = kNever;
    bool at_begin_ = true;
};

}  // namespace omnislip

#endif
