#include "board/spi_port.h"

#include <algorithm>

#include "hal/lf2407a/registers.h"

namespace omnislip {

Eeprom::Eeprom(Board &board) : board_(board), bytes_(kBytes, 0xFF) {}

bool Eeprom::writing() const {
    return board_.now() < busy_until_;
}

void Eeprom::cut_power(unsigned seed) {
    if (writing()) {
        std::minstd_rand random(seed + 1);
        const int page = begin_ / kPage * kPage;
        for (std::size_t i = 0; i < page_.size(); ++i) {
            const int at = page + (begin_ + static_cast<int>(i)) % kPage;
            bytes_[static_cast<std::size_t>(at)] = static_cast<std::uint8_t>(random() >> 8);
        }
    }
    busy_until_ = board_.now();
    selected_ = write_enabled_ = false;
    position_ = 0;
}

void Eeprom::select(bool selected) {
    const bool complete = selected_ && !selected && position_ > 0;
    if (complete && instruction_ == kWriteEnable)
        write_enabled_ = true;
    if (complete && instruction_ == kWrite) {
        if (page_.empty())
            board_.fault("EEPROM: WRITE without data");
        const int page = begin_ / kPage * kPage;
        for (std::size_t i = 0; i < page_.size(); ++i) {
            const int at = page + (begin_ + static_cast<int>(i)) % kPage;
            bytes_[static_cast<std::size_t>(at)] = page_[i];
        }
        busy_until_ = board_.now() + kWriteCycle;
        write_enabled_ = false;
        ++writes_;
    }
    if (selected != selected_)
        position_ = 0;
    selected_ = selected;
}

void Eeprom::begin(std::uint8_t instruction) {
    if (writing() && instruction != kStatus)
        board_.fault("EEPROM: instruction during a write cycle");
    if (instruction == kWrite && !write_enabled_)
        board_.fault("EEPROM: WRITE without WREN");
    if (instruction != kWrite && instruction != kRead && instruction != kStatus &&
        instruction != kWriteEnable)
        board_.fault("EEPROM: unknown instruction");
    instruction_ = instruction;
    page_.clear();
}

std::uint8_t Eeprom::exchange(std::uint8_t sent) {
    if (!selected_)
        board_.fault("SPI transfer without chip select");
    const int position = position_++;
    if (position == 0) {
        begin(sent);
    } else if (instruction_ == kStatus) {
        return static_cast<std::uint8_t>((writing() ? 1 : 0) | (write_enabled_ ? 2 : 0));
    } else if (position <= 2 && (instruction_ == kRead || instruction_ == kWrite)) {
        address_ = (position == 1 ? 0 : address_) << 8 | sent;
        begin_ = address_ %= position == 2 ? kBytes : 0x10000;
    } else if (instruction_ == kRead) {
        const std::uint8_t byte = bytes_[static_cast<std::size_t>(address_)];
        address_ = (address_ + 1) % kBytes;
        return byte;
    } else if (instruction_ == kWrite) {
        page_.push_back(sent);
    }
    return 0xFF;
}

void SpiPort::reset() {
    done_at_ = kNever;
}

void SpiPort::start(std::uint16_t value) {
    const std::uint16_t control = board_.value(SPICTL);
    if (!(board_.value(SPICCR) & SPICCR_RUN))
        board_.fault("SPITXBUF written while SPI SW RESET = 0");
    if ((control & 0x1F) != (SPICTL_PHASE | SPICTL_MASTER | SPICTL_TALK) ||
        (board_.value(SPICCR) & 0x4F) != SPICCR_8_BITS)
        board_.fault("only master, 8 bits, mode 0 without interrupts is modelled");
    if (!board_.spi_pins())
        board_.fault("SPI pins are not switched to the SPI (MCRB)");
    if (done_at_ != kNever)
        board_.fault("SPITXBUF written during a transfer");
    const BoardTime bit = board_.cycles(board_.value(SPIBRR) < 3 ? 4 : board_.value(SPIBRR) + 1);
    if (1.0 / (static_cast<double>(bit) * kBoardTime_s) > Eeprom::kFastest_hz * (1.0 + 1e-9))
        board_.fault("SPI clock is above the 2 MHz of the EEPROM");
    sent_ = static_cast<std::uint8_t>(value >> 8);
    done_at_ = board_.now() + 8 * bit;
}

void SpiPort::run() {
    done_at_ = kNever;
    if (board_.value(SPISTS) & SPISTS_INT_FLAG)
        board_.set_bits(SPISTS, SPISTS_OVERRUN, true);
    board_.set(SPIRXBUF, eeprom_.exchange(sent_));
    board_.set_bits(SPISTS, SPISTS_INT_FLAG, true);
}

std::uint16_t SpiPort::read(std::uint16_t address) {
    const std::uint16_t value = board_.value(address);
    if (address == SPIRXBUF) {
        if (!(board_.value(SPISTS) & SPISTS_INT_FLAG))
            board_.fault("SPIRXBUF read before the character is complete");
        board_.set_bits(SPISTS, SPISTS_INT_FLAG, false);
    }
    return value;
}

void SpiPort::written(std::uint16_t address, std::uint16_t value) {
    const bool setting =
        address == SPICTL || address == SPIBRR || (address == SPICCR && (value & SPICCR_RUN) == 0);
    if (setting && done_at_ != kNever)
        board_.fault("SPI set up during a transfer");
    if (address == SPICTL && (board_.value(SPICCR) & SPICCR_RUN))
        board_.fault("SPI mode changed while SPI SW RESET = 1");
    if (address == SPITXBUF)
        start(value);
}

}  // namespace omnislip
