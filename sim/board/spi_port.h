/* spi_port.h - SPI of the virtual board and the EEPROM behind it.
 *
 * SPI: master, 8 bits, mode 0; a character takes 8 (SPIBRR + 1) cycles. SPITXBUF is sent from bit
 * 15 down, SPIRXBUF holds what came back in its low bits. Other formats are refused.
 *
 * EEPROM: 25xx640 (data sheet 25AA640A/25LC640A): 8192 bytes, pages of 32, write cycle up to 5 ms,
 * instructions READ, WRITE, WREN, RDSR. It writes what it was told when chip select rises, provided
 * WREN came before. Power that fails during the write cycle leaves the bytes under way undefined.
 * An instruction that the part would ignore is refused.
 */
#ifndef OMNISLIP_SIM_BOARD_SPI_PORT_H
#define OMNISLIP_SIM_BOARD_SPI_PORT_H

#include <random>
#include <vector>

#include "board/board.h"

namespace omnislip {

class Eeprom {
  public:
    static constexpr int kBytes = 8192, kPage = 32;
    static constexpr double kFastest_hz = 2e6; /* 25LC640 below 4.5 V */
    static constexpr BoardTime kWriteCycle = 200000;

    explicit Eeprom(Board &board);
    std::vector<std::uint8_t> &bytes() {
        return bytes_;
    }
    bool writing() const;
    /* WRITE instructions carried out. */
    long writes() const {
        return writes_;
    }
    /* The supply is gone now: undefined are the bytes being written. */
    void cut_power(unsigned seed);

    void select(bool selected);
    std::uint8_t exchange(std::uint8_t sent);

  private:
    enum Instruction { kWrite = 2, kRead = 3, kStatus = 5, kWriteEnable = 6 };
    void begin(std::uint8_t instruction);

    Board &board_;
    std::vector<std::uint8_t> bytes_;
    std::vector<std::uint8_t> page_;
    BoardTime busy_until_ = 0;
    bool selected_ = false, write_enabled_ = false;
    int position_ = 0, instruction_ = 0, address_ = 0, begin_ = 0;
    long writes_ = 0;
};

class SpiPort {
  public:
    SpiPort(Board &board, Eeprom &eeprom) : board_(board), eeprom_(eeprom) {}
    void reset();
    std::uint16_t read(std::uint16_t address);
    void written(std::uint16_t address, std::uint16_t value);
    BoardTime next_event() const {
        return done_at_;
    }
    void run();

  private:
    void start(std::uint16_t value);

    Board &board_;
    Eeprom &eeprom_;
    BoardTime done_at_ = kNever;
    std::uint8_t sent_ = 0;
};

}  // namespace omnislip

#endif
