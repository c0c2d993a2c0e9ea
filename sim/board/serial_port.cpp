#include "board/serial_port.h"

#include <algorithm>
#include <cmath>

#include "hal/lf2407a/registers.h"

namespace omnislip {
namespace {

constexpr int kFrameBits = 10;
constexpr unsigned kStopBit = 1U << (kFrameBits - 1);

/* Start bit 0, eight data bits from the lowest, stop bit 1. */
unsigned frame(std::uint8_t byte) {
    return static_cast<unsigned>(byte) << 1 | kStopBit;
}

}  // namespace

SerialPort::SerialPort(Board &board) : board_(board) {
    set_peer_baud(115200.0);
}

void SerialPort::set_peer_baud(double baud) {
    peer_bit_ = 1.0 / (baud * kBoardTime_s);
}

void SerialPort::send(const std::vector<std::uint8_t> &bytes) {
    peer_free_ = std::max(peer_free_, static_cast<double>(board_.now()));
    for (std::uint8_t byte : bytes) {
        to_board_.push_back({peer_free_, peer_bit_, frame(byte), kFrameBits});
        peer_free_ += kFrameBits * peer_bit_;
    }
    start_receiving();
    board_.reschedule();
}

void SerialPort::send_break(int bits) {
    peer_free_ = std::max(peer_free_, static_cast<double>(board_.now()));
    to_board_.push_back({peer_free_, peer_bit_, 0, bits});
    peer_free_ += (bits + 1) * peer_bit_;
    start_receiving();
    board_.reschedule();
}

std::vector<std::uint8_t> SerialPort::take_received() {
    std::vector<std::uint8_t> bytes;
    bytes.swap(from_board_);
    return bytes;
}

double SerialPort::bit() const {
    const int brr = board_.value(SCIHBAUD) << 8 | board_.value(SCILBAUD);
    return static_cast<double>(board_.cycles(brr == 0 ? 16 : 8 * (brr + 1)));
}

bool SerialPort::running() const {
    return board_.value(SCICTL1) & SCICTL1_RUN;
}

void SerialPort::reset() {
    shifting_ = false;
    sent_at_ = kNever;
}

/* Ten bits as seen by a receiver whose bit lasts `bit`, from the falling edge of the start bit. */
unsigned SerialPort::sample(const Character &sent, double bit) {
    unsigned seen = 0;
    for (int k = 0; k < kFrameBits; ++k) {
        const int index = static_cast<int>(std::floor((k + 0.5) * bit / sent.bit));
        const bool level = index >= sent.count || (sent.bits >> index & 1U);
        seen |= static_cast<unsigned>(level) << k;
    }
    return seen;
}

/* The stop bit of the character on the line is judged at its middle. */
void SerialPort::start_receiving() {
    if (receive_at_ != kNever || to_board_.empty())
        return;
    const Character &character = to_board_.front();
    const double middle = character.start + (kFrameBits - 0.5) * bit();
    const double end = character.start + (character.count - 0.5) * character.bit;
    receive_at_ = std::max(board_.now(), static_cast<BoardTime>(std::max(middle, end)));
}

void SerialPort::finish_receiving() {
    const Character character = to_board_.front();
    to_board_.pop_front();
    receive_at_ = kNever;
    start_receiving();
    const bool listening = running() && (board_.value(SCICTL1) & SCICTL1_RXENA) &&
                           (board_.value(SCSR1) & SCSR1_SCI) && board_.serial_pins();
    if (!listening)
        return;
    const unsigned seen = sample(character, bit());
    std::uint16_t status = board_.value(SCIRXST);
    if (status & SCIRXST_RXRDY)
        status |= SCIRXST_OE;
    if (!(seen & kStopBit))
        status |= seen == 0 ? SCIRXST_FE | SCIRXST_BRKDT : SCIRXST_FE;
    if (status & (SCIRXST_OE | SCIRXST_FE | SCIRXST_BRKDT | SCIRXST_PE))
        status |= SCIRXST_RXERROR;
    const bool rises = !(status & SCIRXST_RXRDY);
    board_.set(SCIRXST, status | SCIRXST_RXRDY);
    board_.set(SCIRXBUF, seen >> 1 & 0xFF);
    if (rises && (board_.value(SCICTL2) & SCICTL2_RX_INT))
        board_.request(level(SCIPRI_RX_LOW), PIVR_RXINT);
}

int SerialPort::level(std::uint16_t low_priority) const {
    return board_.value(SCIPRI) & low_priority ? 5 : 1;
}

void SerialPort::start_sending() {
    shifting_ = true;
    shifting_byte_ = buffer_;
    shift_start_ = static_cast<double>(board_.now());
    sent_at_ = board_.now() + static_cast<BoardTime>(kFrameBits * bit());
    board_.set_bits(SCICTL2, SCICTL2_TXRDY, true);
    if (board_.value(SCICTL2) & SCICTL2_TX_INT)
        board_.request(level(SCIPRI_TX_LOW), PIVR_TXINT);
}

void SerialPort::finish_sending() {
    const Character sent = {shift_start_, bit(), frame(shifting_byte_), kFrameBits};
    const unsigned seen = sample(sent, peer_bit_);
    if (!board_.serial_pins() || !(seen & kStopBit)) {
        ++unreadable_;
    } else {
        from_board_.push_back(static_cast<std::uint8_t>(seen >> 1));
    }
    shifting_ = false;
    sent_at_ = kNever;
    if (board_.value(SCICTL2) & SCICTL2_TXRDY)
        board_.set_bits(SCICTL2, SCICTL2_TXEMPTY, true);
    else
        start_sending();
}

std::uint16_t SerialPort::read(std::uint16_t address) {
    const std::uint16_t value = board_.value(address);
    if (address == SCIRXBUF)
        board_.set_bits(SCIRXST, SCIRXST_RXRDY, false);
    return value;
}

void SerialPort::written(std::uint16_t address, std::uint16_t value) {
    const bool format = address == SCICCR || address == SCIHBAUD || address == SCILBAUD;
    if (format && running())
        board_.fault("format or baud rate changed while SW RESET = 1");
    if (address == SCICCR && value != SCICCR_8N1)
        board_.fault("only 8N1 without loopback is modelled");
    if (address == SCICTL1 && !(value & SCICTL1_RUN)) {
        reset();
        board_.set(SCIRXST, 0);
        board_.set_bits(SCICTL2, SCICTL2_TXRDY | SCICTL2_TXEMPTY, true);
    }
    if (address == SCITXBUF) {
        if (!running() || !(board_.value(SCICTL1) & SCICTL1_TXENA))
            board_.fault("SCITXBUF written while the transmitter is off");
        if (!(board_.value(SCICTL2) & SCICTL2_TXRDY))
            board_.fault("SCITXBUF written while TXRDY = 0: a byte is lost");
        buffer_ = static_cast<std::uint8_t>(value);
        board_.set_bits(SCICTL2, SCICTL2_TXRDY | SCICTL2_TXEMPTY, false);
        if (!shifting_)
            start_sending();
    }
}

BoardTime SerialPort::next_event() const {
    return std::min(receive_at_, sent_at_);
}

void SerialPort::run() {
    if (receive_at_ <= board_.now())
        finish_receiving();
    if (sent_at_ <= board_.now())
        finish_sending();
}

}  // namespace omnislip
