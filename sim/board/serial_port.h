/* serial_port.h - SCI of the virtual board and the line to its peer.
 *
 * A character is ten bits of 8 (BRR + 1) cycles. The receiver samples each bit of the peer's
 * character in the middle of a bit of its own; so a wrong baud rate gives wrong bits and framing
 * errors as on a wire. One character is buffered each way: the next that arrives before the reader
 * overruns it. Errors stay until SW RESET; SW RESET also drops the character being sent [M].
 * TXRDY and RXRDY request their interrupt when they rise, not while they are set [M].
 */
#ifndef OMNISLIP_SIM_BOARD_SERIAL_PORT_H
#define OMNISLIP_SIM_BOARD_SERIAL_PORT_H

#include <deque>
#include <vector>

#include "board/board.h"

namespace omnislip {

class SerialPort {
  public:
    explicit SerialPort(Board &board);

    /* The peer sends bytes, one after the other without gap, from now on. */
    void send(const std::vector<std::uint8_t> &bytes);
    /* What the peer received since the last call; characters that it cannot read are counted. */
    std::vector<std::uint8_t> take_received();
    long unreadable() const {
        return unreadable_;
    }
    void set_peer_baud(double baud);
    /* The peer holds the line low for that many bits of its own, from when it is free. */
    void send_break(int bits);
    long waiting() const {
        return static_cast<long>(to_board_.size());
    }

    void reset();
    std::uint16_t read(std::uint16_t address);
    void written(std::uint16_t address, std::uint16_t value);
    BoardTime next_event() const;
    void run();

  private:
    struct Character {
        double start, bit;
        unsigned bits; /* from the start bit on, idle line after the last */
        int count;
    };
    double bit() const;
    bool running() const;
    static unsigned sample(const Character &sent, double bit);
    void start_receiving();
    void finish_receiving();
    void start_sending();
    void finish_sending();
    int level(std::uint16_t low_priority) const;

    Board &board_;
    double peer_bit_ = 0.0, peer_free_ = 0.0;
    std::deque<Character> to_board_;
    std::vector<std::uint8_t> from_board_;
    long unreadable_ = 0;
    BoardTime receive_at_ = kNever, sent_at_ = kNever;
    bool shifting_ = false;
    double shift_start_ = 0.0;
    std::uint8_t shifting_byte_ = 0, buffer_ = 0;
};

}  // namespace omnislip

#endif
