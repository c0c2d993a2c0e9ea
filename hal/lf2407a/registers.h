/* Registers of the TMS320LF2407A that the drivers and the virtual board use: addresses in data
 * space and bits, with the names of TI's manuals (SPRU357 system and peripherals).
 *
 * Addresses agree between three independent public headers. Where a bit or code is known from
 * memory only, the line says [M]: check it against the manual before the first hardware test.
 */
#ifndef HAL_LF2407A_REGISTERS_H
#define HAL_LF2407A_REGISTERS_H

/* ---- Core: interrupt mask and flags; bit n - 1 is INTn ---- */
#define IMR 0x0004
#define IFR 0x0006
#define INT3_BIT 0x0004
#define INT5_BIT 0x0010
#define ALL_INT_BITS 0x003F

/* ---- System ---- */
#define PIRQR0 0x7010
#define PIRQR1 0x7011
#define PIRQR2 0x7012
#define SCSR1 0x7018
#define SCSR1_CLOCK_TIMES_4                                               \
    0x0000 /* CLKPS 000: 10 MHz to 40 MHz; reset gives 111, times 0.5 [M] \
            */
#define SCSR1_CLKPS 0x0E00
#define SCSR1_ADC 0x0080
#define SCSR1_SCI 0x0040
#define SCSR1_SPI 0x0020
#define SCSR1_EVB 0x0008
#define SCSR1_EVA 0x0004
#define SCSR1_ILLADR 0x0001 /* write 1 to clear */
#define SCSR2 0x7019
#define SCSR2_WD_OVERRIDE 0x0020 /* writing 1 makes the watchdog impossible to disable */
#define SCSR2_XMIF_HI_Z 0x0010   /* 0: the external bus is driven */
#define SCSR2_BOOT_EN 0x0008     /* 1: flash, 0: boot ROM at 0000h */
#define SCSR2_SARAM 0x0003       /* DON, PON: SARAM in data and program space */
#define DINR 0x701C
#define PIVR 0x701E
#define PIVR_PHANTOM 0x0000
#define PIVR_RXINT 0x0006
#define PIVR_TXINT 0x0007
#define PIVR_T2PINT 0x002B

/* ---- Watchdog ---- */
#define WDCNTR 0x7023
#define WDKEY 0x7025
#define WDKEY_FIRST 0x0055
#define WDKEY_SECOND 0x00AA
#define WDCR 0x7029
#define WDCR_WDFLAG 0x0080 /* it was the watchdog that reset; write 1 to clear */
#define WDCR_WDDIS 0x0040
#define WDCR_CHECK 0x0028 /* must be written so, else reset */
#define WDCR_WDPS 0x0007  /* 111: 8 bits of CLKOUT / 512 / 64 = 210 ms at 40 MHz [M] */

/* ---- SPI ---- */
#define SPICCR 0x7040
#define SPICCR_RUN 0x0080 /* SPI SW RESET: 0 holds it in reset */
#define SPICCR_POLARITY 0x0040
#define SPICCR_8_BITS 0x0007
#define SPICTL 0x7041
#define SPICTL_PHASE 0x0008 /* with polarity 0: output half a clock before the rising edge [M] */
#define SPICTL_MASTER 0x0004
#define SPICTL_TALK 0x0002
#define SPISTS 0x7042
#define SPISTS_OVERRUN 0x0080
#define SPISTS_INT_FLAG 0x0040 /* a character is complete; reading SPIRXBUF clears it [M] */
#define SPISTS_TX_FULL 0x0020
#define SPIBRR 0x7044
#define SPIRXBUF 0x7047
#define SPITXBUF 0x7048 /* sent from bit 15 down, received from bit 0 up [M] */
#define SPIPRI 0x704F

/* ---- SCI ---- */
#define SCICCR 0x7050
#define SCICCR_8N1 0x0007
#define SCICTL1 0x7051
#define SCICTL1_RUN 0x0020 /* SW RESET: 0 clears flags and stops both directions */
#define SCICTL1_TXENA 0x0002
#define SCICTL1_RXENA 0x0001
#define SCIHBAUD 0x7052
#define SCILBAUD 0x7053
#define SCICTL2 0x7054
#define SCICTL2_TXRDY 0x0080
#define SCICTL2_TXEMPTY 0x0040
#define SCICTL2_RX_INT 0x0002
#define SCICTL2_TX_INT 0x0001
#define SCIRXST 0x7055
#define SCIRXST_RXERROR 0x0080 /* any of those below; latched until SW RESET [M] */
#define SCIRXST_RXRDY 0x0040
#define SCIRXST_BRKDT 0x0020
#define SCIRXST_FE 0x0010
#define SCIRXST_OE 0x0008
#define SCIRXST_PE 0x0004
#define SCIRXBUF 0x7057
#define SCITXBUF 0x7059
#define SCIPRI 0x705F
#define SCIPRI_TX_LOW 0x0040 /* INT5 instead of INT1 */
#define SCIPRI_RX_LOW 0x0020

/* ---- Pins ---- */
#define MCRA 0x7090
#define MCRA_SCI 0x0003
#define MCRA_PWM1_TO_4 0x03C0
#define MCRB 0x7092
#define MCRB_MUST_STAY 0xFE00 /* emulator pins */
#define MCRB_SPI 0x001C       /* SPISIMO, SPISOMI, SPICLK; SPISTE stays IOPC5 */
#define MCRC 0x7094
#define MCRC_PWM7_TO_10 0x001E
#define PEDATDIR 0x7095
#define PFDATDIR 0x7096
#define PADATDIR 0x7098
#define PBDATDIR 0x709A
#define PCDATDIR 0x709C
#define PCDATDIR_IOPC5_OUTPUT 0x2000
#define PCDATDIR_IOPC5 0x0020
#define PDDATDIR 0x709E

/* ---- ADC ---- */
#define ADCTRL1 0x70A0
#define ADCTRL1_RESET 0x4000
#define ADCTRL1_ACQUIRE 0x0F00   /* ACQ PS */
#define ADCTRL1_ACQUIRE_4 0x0100 /* ACQ PS 1: window of 4 ADC clocks [M] */
#define ADCTRL1_CPS 0x0080
#define ADCTRL1_SEQ_CASC 0x0010
#define ADCTRL2 0x70A1
#define ADCTRL2_RST_SEQ1 0x4000
#define ADCTRL2_SOC_SEQ1 0x2000
#define ADCTRL2_SEQ1_BSY 0x1000
#define ADCTRL2_INT_ENA_SEQ1 0x0C00
#define ADCTRL2_INT_FLAG_SEQ1 0x0200
#define ADCTRL2_EVA_SOC_SEQ1 0x0100
#define MAXCONV 0x70A2
#define CHSELSEQ1 0x70A3
#define CHSELSEQ2 0x70A4
#define CHSELSEQ3 0x70A5
#define CHSELSEQ4 0x70A6
#define RESULT0 0x70A8 /* bits 15..6 [M]; sixteen of them in a row */
#define RESULT15 0x70B7

/* ---- Event managers: EVB is EVA at + 100h, its T3, T4 and CMPR4..6 at T1, T2 and CMPR1..3 ---- */
#define EVA 0x7400
#define EVB 0x7500
#define GPTCON 0x00
#define GPTCON_T2_ADC_COMPARE 0x0600 /* T2TOADC 11: compare match of T2 starts the ADC [M] */
#define T1CNT 0x01
#define T1CMPR 0x02
#define T1PR 0x03
#define T1CON 0x04
#define T2CNT 0x05
#define T2CMPR 0x06
#define T2PR 0x07
#define T2CON 0x08
#define TCON_FREE 0x8000 /* runs on when the emulator halts the CPU */
#define TCON_UP_DOWN 0x0800
#define TCON_UP 0x1000
#define TCON_DIVIDE_BY_8 0x0300
#define TCON_ENABLE 0x0040
#define TCON_COMPARE 0x0002
#define COMCON 0x11
#define COMCON_CENABLE 0x8000
#define COMCON_FCOMPOE 0x0200 /* 0: the six PWM pins are high-impedance */
#define COMCON_PDPINT 0x0100  /* level of the protection pin, low: tripped (240xA) [M: polarity] */
#define ACTR 0x13
#define ACTR_ACTIVE_HIGH 0x2 /* in the two bits of a pin; 0: forced low */
#define DBTCON 0x15
#define CMPR1 0x17
#define CMPR2 0x18
#define CMPR3 0x19
#define EVIMRA 0x2C
#define EVIMRB 0x2D
#define EVIMRC 0x2E
#define EVIFRA 0x2F
#define EVIFRB 0x30
#define EVIFRC 0x31
#define EVA_PDPINT 0x0001 /* in EVIMRA and EVIFRA */
#define EVB_T2PINT 0x0001 /* in EVIMRB and EVIFRB */

/* ---- I/O space ---- */
#define WSGR 0xFFFF
#define WSGR_DATA_SHIFT 3
#define WSGR_IO_SHIFT 6

#endif
