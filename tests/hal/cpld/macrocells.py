"""Whether the encoder counters fit an XC95144XL, as far as yosys can tell.

yosys maps the Verilog to macrocells of CoolRunner-II, a younger family with the same macrocell: an
OR of product terms, an XOR, a D or T flip-flop. This counts them as an XC95144XL has them: product
terms belong to one macrocell, the clock comes from a global pin, an output that can be switched off
takes one product term for it; and looks for a division into its function blocks. The limits are
from memory of Xilinx' data sheets DS054 and DS056. Xilinx' fitter was not run: it also places pins
and may combine terms differently.

Usage: python macrocells.py FOLDER_OF_REGISTERS_VH    (exit status 1 when it does not fit)
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

SOURCES = Path(__file__).parents[3] / "hal/cpld"
TOP = "xc95144xl"
BLOCKS, BLOCK_MACROCELLS, BLOCK_TERMS, BLOCK_INPUTS = 8, 18, 90, 54
BLOCK_OUTPUTS = 3  # of some ten pins: spread, so that no block must read all of the copies


@dataclass
class Macrocell:
    """Net that it makes, product terms, nets that they read."""

    net: int
    terms: int
    inputs: set[int]
    output: bool


def synthesize(include: Path) -> dict:
    """Cells of the flattened design after yosys' mapping to CoolRunner-II."""
    sources = " ".join(str(path) for path in sorted(SOURCES.glob("*.v")))
    with tempfile.TemporaryDirectory() as folder:
        netlist = Path(folder) / "netlist.json"
        script = f"read_verilog -I{include} {sources}; synth_coolrunner2 -top {TOP} -json {netlist}"
        subprocess.run(["yosys", "-q", "-p", script], check=True)
        return json.loads(netlist.read_text())["modules"][TOP]["cells"]


def macrocells(cells: dict) -> list[Macrocell]:
    """Flip-flops and outputs, with the product terms before them."""
    driver = {}
    for cell in cells.values():
        for port in ("OUT", "O", "Q"):
            for net in cell["connections"].get(port, []):
                driver[net] = cell

    def read(net: int | str) -> tuple[int, set[int]]:
        """Product terms behind `net` and the nets that they read."""
        cell = driver.get(net)
        if cell is None or cell["type"] in ("IBUF", "FDCP", "FTCP"):
            return 0, {net} if isinstance(net, int) else set()
        ports = cell["connections"]
        parts = [read(n) for name in ports if name.startswith("IN") for n in ports[name]]
        inputs = set().union(*(nets for _, nets in parts))
        if cell["type"] == "ANDTERM":
            return 1, inputs
        return sum(terms for terms, _ in parts), inputs

    found = []
    for cell in cells.values():
        ports = cell["connections"]
        if cell["type"] in ("FDCP", "FTCP"):
            terms, inputs = read(ports.get("D", ports.get("T"))[0])
            found.append(Macrocell(ports["Q"][0], max(terms, 1), inputs, False))
        elif cell["type"] == "IOBUFE":
            terms, inputs = read(ports["I"][0])
            enable_terms, enable_inputs = read(ports["E"][0]) if "E" in ports else (0, set())
            found.append(
                Macrocell(ports["IO"][0], terms + enable_terms, inputs | enable_inputs, True)
            )
    return found


def divide(cells: list[Macrocell]) -> list[list[Macrocell]] | None:
    """Function blocks that hold the macrocells; None if none was found.

    Each macrocell goes, the widest first, to the block that needs the fewest new inputs for it.
    """
    blocks: list[list[Macrocell]] = [[] for _ in range(BLOCKS)]

    def inputs(block: list[Macrocell]) -> set[int]:
        return set().union(*(cell.inputs for cell in block))

    for cell in sorted(cells, key=lambda c: (-len(c.inputs), c.net)):
        free = [
            block
            for block in blocks
            if len(block) < BLOCK_MACROCELLS
            and sum(c.terms for c in block) + cell.terms <= BLOCK_TERMS
            and len(inputs(block) | cell.inputs) <= BLOCK_INPUTS
            and sum(c.output for c in block) + cell.output <= BLOCK_OUTPUTS
        ]
        if not free:
            return None
        min(free, key=lambda block: (len(cell.inputs - inputs(block)), len(block))).append(cell)
    return blocks


def main() -> int:
    """Print the estimate."""
    cells = macrocells(synthesize(Path(sys.argv[1])))
    terms = sum(cell.terms for cell in cells)
    room, term_room = BLOCKS * BLOCK_MACROCELLS, BLOCKS * BLOCK_TERMS
    print(f"{len(cells)} macrocells of {room}, {terms} product terms of {term_room}")
    print(f"largest macrocell: {max(cell.terms for cell in cells)} terms")
    blocks = divide(cells)
    if blocks is None:
        print("no division into function blocks was found")
        return 1
    for number, block in enumerate(blocks, 1):
        reads = len(set().union(*(cell.inputs for cell in block)))
        print(
            f"block {number}: {len(block)} macrocells, {sum(c.terms for c in block)} terms, "
            f"{reads} inputs, {sum(c.output for c in block)} outputs"
        )
    return 0 if len(cells) <= room and terms <= term_room else 1


if __name__ == "__main__":
    sys.exit(main())
