; Vector table, and what must happen before C starts. For TI's assembler (dspa of the 7.04 tools);
; never assembled so far, that assembler cannot be had here.
;
; Every vector without a routine of its own enters the trap: outputs off, then the watchdog resets.
; That includes NMI, which the chip raises for an access to an illegal address.

        .global _c_int0, _board_int3, _board_int5

        .sect   "vectors"
        B       start                   ; 00 reset
        B       trap                    ; 02 INT1: PDPINTA and B act in hardware, masked here
        B       trap                    ; 04 INT2
        B       _board_int3             ; 06 INT3: T2 period
        B       trap                    ; 08 INT4
        B       _board_int5             ; 0A INT5: SCI
        B       trap                    ; 0C INT6
        B       trap                    ; 0E reserved
        B       trap                    ; 10 software 8
        B       trap                    ; 12 software 9
        B       trap                    ; 14 software 10
        B       trap                    ; 16 software 11
        B       trap                    ; 18 software 12
        B       trap                    ; 1A software 13
        B       trap                    ; 1C software 14
        B       trap                    ; 1E software 15
        B       trap                    ; 20 software 16
        B       trap                    ; 22 TRAP
        B       trap                    ; 24 NMI
        B       trap                    ; 26 reserved
        B       trap                    ; 28 software 20
        B       trap                    ; 2A software 21
        B       trap                    ; 2C software 22
        B       trap                    ; 2E software 23
        B       trap                    ; 30 software 24
        B       trap                    ; 32 software 25
        B       trap                    ; 34 software 26
        B       trap                    ; 36 software 27
        B       trap                    ; 38 software 28
        B       trap                    ; 3A software 29
        B       trap                    ; 3C software 30
        B       trap                    ; 3E software 31

        .text
; C keeps its stack and data in the SARAM, which must be data memory before _c_int0 runs; copying
; the initial values at the slow clock of reset must not meet the watchdog of 3.3 ms.
start:  SETC    INTM
        LDP     #0E0h                   ; 7000h
        SPLK    #000Bh, 19h             ; SCSR2: flash, SARAM as data, bus driven
        SPLK    #002Fh, 29h             ; WDCR: slowest; WDFLAG stays for board_start to read
        B       _c_int0

trap:   SETC    INTM
        LDP     #0E8h                   ; 7400h
        SPLK    #0000h, 11h             ; COMCONA: pins high-impedance
        LDP     #0EAh                   ; 7500h
        SPLK    #0000h, 11h             ; COMCONB
halt:   B       halt
        .end
