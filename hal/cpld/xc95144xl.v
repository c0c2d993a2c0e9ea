// The part and its pins: encoder_counters with a data bus that goes both ways.
`include "registers.vh"

module xc95144xl (
    input wire clock,
    input wire [3:0] encoder_a,
    input wire [3:0] encoder_b,
    input wire ds_n,
    input wire rd_n,
    input wire we_n,
    input wire [2:0] address,
    inout wire [`CPLD_COUNT1_BITS-1:0] data
);
    wire drive;
    wire [`CPLD_COUNT1_BITS-1:0] value;

    encoder_counters counters (
        .clock(clock),
        .encoder_a(encoder_a),
        .encoder_b(encoder_b),
        .ds_n(ds_n),
        .rd_n(rd_n),
        .we_n(we_n),
        .address(address),
        .drive(drive),
        .data(value)
    );
    assign data = drive ? value : {`CPLD_COUNT1_BITS{1'bz}};
endmodule
