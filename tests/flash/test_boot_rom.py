"""Loading a RAM image through the boot ROM of a chip, also over a line that damages bytes."""

import json

import pytest
from boot_rom_chip import Chip
from omnislip.errors import InputError, RobotError
from omnislip.flash import boot_rom
from omnislip.flash.image import Block, make_image
from omnislip.link.port import SerialLine
from program_files import coff, intel_hex, section

WORDS = [(37 * k + 0x0D0D) % 0x10000 for k in range(200)]


@pytest.fixture
def chip():
    chips = []

    def make(**settings):
        chips.append(Chip(**settings).start())
        return chips[-1]

    yield make
    for made in chips:
        made.stop()


@pytest.fixture(autouse=True)
def short_times(monkeypatch):
    """A pseudo-terminal answers at once."""
    monkeypatch.setattr(boot_rom, "ECHO_TIMEOUT_S", 0.5)
    monkeypatch.setattr(boot_rom, "SYNC_PERIOD_S", 0.03)
    monkeypatch.setattr(boot_rom, "SYNC_TIME_S", 2.0)


def image(*blocks):
    return make_image("program.out", "test", [Block(f"b{a:x}", a, tuple(w)) for a, w in blocks])


def load(chip, program, told=None):
    line = SerialLine(chip.port, boot_rom.BAUD)
    try:
        return boot_rom.load(line, program, chip.reset, [].append if told is None else told.append)
    finally:
        line.close()


def test_a_program_is_loaded_and_started(chip):
    target = chip()
    assert load(target, image((0x8000, WORDS))) == boot_rom.Loaded(1, confirmed=True)
    assert target.running == 0x8000
    assert target.memory[0x8000 : 0x8000 + len(WORDS)] == WORDS


def test_several_blocks_become_one(chip):
    target = chip()
    load(target, image((0x8010, [1, 2]), (0x8000, WORDS[:4])))
    assert target.memory[0x8000:0x8012] == WORDS[:4] + [0xFFFF] * 12 + [1, 2]


def test_a_program_up_to_the_end_of_its_memory(chip):
    target = chip()
    load(target, image((0xFFF0, WORDS[:16])))
    assert target.memory[0xFFF0:] == WORDS[:16] or target.memory[0xFFF0:-1] == WORDS[:15]


@pytest.mark.parametrize("seed", range(6))
def test_damage_is_met_by_another_attempt_and_never_started(chip, seed):
    """One byte in 1000 is lost or changed each way; a transfer has 406 bytes and 406 echoes."""
    target = chip(damage=1 / 1000, seed=seed)
    told = []
    outcome = "loaded"
    try:
        loaded = load(target, image((0x8000, WORDS)), told)
    except RobotError as error:
        outcome = str(error)
    failed = [line for line in told if line.startswith("attempt")]
    if outcome == "loaded":
        assert loaded.attempts == target.resets == len(failed) + 1
        assert target.memory[0x8000 : 0x8000 + len(WORDS)] == WORDS
        assert target.running == 0x8000 or not loaded.confirmed
    else:
        assert "attempts each met a wrong echo" in outcome
        assert len(failed) == 5 and target.running is None


def test_damage_of_every_byte_ends_after_some_attempts(chip):
    target = chip()
    reset = target.reset

    def reset_and_spoil():
        reset()
        target.damage = 0.0

    line = SerialLine(target.port, boot_rom.BAUD)

    def tell(text):
        if text[0].isdigit():  # the transfer has begun
            target.damage = 1.0

    with pytest.raises(RobotError, match="not loaded: 5 attempts each met a wrong echo"):
        boot_rom.load(line, image((0x8000, WORDS)), reset_and_spoil, tell)
    line.close()
    assert target.resets == 5
    assert target.running is None


def test_nothing_is_sent_after_a_wrong_echo_before_a_reset(chip):
    """The chip would take any byte for the rest of the image, and start it."""
    target = chip()
    line = SerialLine(target.port, boot_rom.BAUD)
    sent = []
    write = line.write
    line.write = lambda data: (sent.append(data), write(data))
    at_reset = []

    def reset():
        at_reset.append(len(sent))
        target.reset()

    def tell(text):
        if text.startswith("64 of") and target.resets == 1:
            target.damage = 1.0
        if text.startswith("attempt"):
            at_reset.append(len(sent))
            target.damage = 0.0

    boot_rom.load(line, image((0x8000, WORDS)), reset, tell)
    line.close()
    assert at_reset[1] == at_reset[2]


def test_no_chip(chip):
    with pytest.raises(RobotError, match="the boot ROM has not answered for 2 s"):
        load(chip(answers=False), image((0x8000, WORDS)))


def test_flash_is_refused_with_the_ways_there_are():
    with pytest.raises(InputError, match=r"flash, which the boot ROM cannot write; omnislip flash"):
        boot_rom.transfer_bytes(image((0x44, [1])))


def test_two_memories_are_refused():
    with pytest.raises(InputError, match="lie in different memories"):
        boot_rom.transfer_bytes(image((0x8000, [1]), (0xFF00, [1])))


# ---- the command ----


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "monitor.out"
    path.write_bytes(coff(1, [section(".text", 0x8000, WORDS)]))
    return path


def test_flash_shows_what_goes_where(omnislip, program):
    status, output, _ = omnislip("flash", program)
    assert status == 0
    assert ".text" in output and "8000h" in output and "80C7h" in output and "SARAM" in output


def test_flash_for_machines(omnislip, tmp_path):
    path = tmp_path / "monitor.hex"
    path.write_text(intel_hex(0x0044, [1, 2, 3]))
    status, output, _ = omnislip("flash", path, "--json")
    assert status == 0
    assert json.loads(output)["blocks"] == [
        {"name": "line 1", "address": 0x44, "words": 3, "memory": "flash"}
    ]


def test_flash_loads_when_the_user_has_reset_the_chip(omnislip, program, chip):
    target = chip()
    status, output, errors = omnislip("flash", program, "--port", target.port, typed="\n")
    assert status == 0, errors
    assert "200 words loaded and started" in output
    assert "reset the chip" in errors
    assert target.running == 0x8000


def test_flash_with_nobody_to_reset_the_chip(omnislip, program, chip):
    status, _, errors = omnislip("flash", program, "--port", chip().port)
    assert status == 3
    assert "nobody to reset the chip" in errors


def test_flash_errors(omnislip, program, tmp_path):
    flash_program = tmp_path / "robot.out"
    flash_program.write_bytes(coff(1, [section(".text", 0x44, WORDS)]))
    status, _, errors = omnislip("flash", flash_program, "--port", "none")
    assert status == 2 and "which the boot ROM cannot write" in errors
    status, _, errors = omnislip("flash", program, "--port", tmp_path / "none")
    assert status == 2 and "cannot be opened as a serial port" in errors
    status, _, errors = omnislip("flash", program, "--reset-by", "hand")
    assert status == 2 and "--reset-by must be rts or dtr" in errors


def test_flash_help_has_an_example(omnislip):
    status, output, _ = omnislip("flash", "--help")
    assert status == 0 and "Example: omnislip flash" in output
