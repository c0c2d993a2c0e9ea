/* Memory of the LF2407A for TI's COFF linker (dsplnk 7.04); never linked so far.
 *
 * 0040h-0043h hold the password of the flash: what is programmed there locks the chip. No region
 * covers them, so no section can.
 *
 * .const (const objects, string literals) would have to be data memory, which no flash is: it gets
 * a region too small for anything, so that the link fails. The sources have none, a test checks
 * the objects. */
-c
-stack 0x0200
-heap 0
-l rts2xx.lib
-v1

MEMORY {
    PAGE 0:
        VECTORS : origin = 0000h, length = 0040h
        FLASH   : origin = 0044h, length = 7FBCh
    PAGE 1:
        NOTHING : origin = 0060h, length = 0001h
        DARAM   : origin = 0200h, length = 0200h     /* blocks B0 and B1 */
        SARAM   : origin = 0800h, length = 0800h
}

SECTIONS {
    vectors : > VECTORS PAGE 0
    .text   : > FLASH   PAGE 0
    .cinit  : > FLASH   PAGE 0
    .switch : > FLASH   PAGE 0
    .bss    : > SARAM   PAGE 1
    .stack  : > DARAM   PAGE 1
    .const  : > NOTHING PAGE 1
}
