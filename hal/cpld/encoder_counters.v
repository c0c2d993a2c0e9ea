// Four encoder counters on the external data bus of the LF2407A; register map: registers.def.
//
// clock is CLKOUT of the DSP (40 MHz), so the strobes of its bus keep set-up and hold times here.
// Inputs are sampled every second clock: a pulse shorter than 50 ns is never seen, a level of 100 ns
// always is.
//
// A write of LATCH takes effect at the end of its strobe; the copies are valid two clocks later,
// before another bus cycle can end.
`include "registers.vh"

module encoder_counters (
    input wire clock,
    input wire [3:0] encoder_a,
    input wire [3:0] encoder_b,
    input wire ds_n,  // an access to external data space
    input wire rd_n,
    input wire we_n,
    input wire [2:0] address,
    output wire drive,  // data goes to the bus
    output reg [`CPLD_COUNT1_BITS-1:0] data
);
    localparam WIDTH = `CPLD_COUNT1_BITS;

    reg sample;
    reg writing;
    reg latch;
    reg [3:0] error;
    reg [3:0] error_copy;
    reg [4*WIDTH-1:0] copy;

    wire [3:0] illegal;
    wire [4*WIDTH-1:0] count;

    genvar i;
    generate
        for (i = 0; i < 4; i = i + 1) begin : wheel
            encoder_channel #(.WIDTH(WIDTH)) channel (
                .clock(clock),
                .sample(sample),
                .a(encoder_a[i]),
                .b(encoder_b[i]),
                .count(count[i*WIDTH+:WIDTH]),
                .illegal(illegal[i])
            );
        end
    endgenerate

    wire write_latch = ~ds_n & ~we_n & (address == `CPLD_LATCH);

    initial begin
        sample = 0;
        writing = 0;
        latch = 0;
        error = 0;
        error_copy = 0;
        copy = 0;
    end

    always @(posedge clock) begin
        sample <= ~sample;
        writing <= write_latch;
        latch <= writing & ~write_latch;
        if (latch) begin
            copy <= count;
            error_copy <= error;
        end
        // What comes in the clock of a LATCH belongs to the next interval.
        error <= (latch ? 4'b0 : error) | (sample ? illegal : 4'b0);
    end

    assign drive = ~ds_n & ~rd_n;
    always @* begin
        case (address)
            `CPLD_COUNT1: data = copy[0*WIDTH+:WIDTH];
            `CPLD_COUNT2: data = copy[1*WIDTH+:WIDTH];
            `CPLD_COUNT3: data = copy[2*WIDTH+:WIDTH];
            `CPLD_COUNT4: data = copy[3*WIDTH+:WIDTH];
            `CPLD_ERROR: data = {{(WIDTH - 4) {1'b0}}, error_copy};
            default: data = {{(WIDTH - 8) {1'b0}}, `CPLD_VERSION};
        endcase
    end
endmodule
