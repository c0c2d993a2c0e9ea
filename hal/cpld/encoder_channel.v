// One encoder: inputs A and B to a counter, four counts a period.
//
// Filter: an input passes when two samples in a row agree. The first flip-flop sees the pins at any
// time and may be metastable; it has a whole sample period to settle before anything reads it.
//
// With (A, B) = 00, 10, 11, 01 in the order of counting up, one input changes per count. When A
// changes, up is A differing from B afterwards; when B changes, B agreeing with A. Both are: old B
// differs from new A. Both inputs changing within one sample is an error: the direction is not
// known, and the counter keeps its value.
module encoder_channel #(
    parameter WIDTH = 11
) (
    input wire clock,
    input wire sample,  // one clock long; inputs are looked at
    input wire a,
    input wire b,
    output reg [WIDTH-1:0] count,
    output wire illegal  // valid during sample
);
    reg [1:0] first;
    reg [1:0] second;
    reg [1:0] passed;  // (A, B) after the filter

    wire [1:0] agree = ~(first ^ second);
    wire [1:0] next = (agree & second) | (~agree & passed);
    wire [1:0] changed = next ^ passed;
    assign illegal = &changed;

    // Registered, so that a counter bit toggles on two product terms instead of some twenty.
    reg step;
    reg up;

    // As the part powers up. The first step may be an error: inputs need not start at 00.
    initial begin
        first = 0;
        second = 0;
        passed = 0;
        step = 0;
        up = 0;
        count = 0;
    end

    always @(posedge clock) begin
        if (sample) begin
            first <= {a, b};
            second <= first;
            passed <= next;
            step <= ^changed;
            up <= passed[0] ^ next[1];
            if (step) count <= up ? count + 1'b1 : count - 1'b1;
        end
    end
endmodule
