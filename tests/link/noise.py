"""A line that damages 1 % of all bytes, both ways: what the robot does and what the host notices.

    .venv/bin/python tests/link/noise.py 600          ten minutes of robot time, as fast as it goes
    .venv/bin/python tests/link/noise.py 600 --pty    the same in real time on a pseudo-terminal

With --on-board the robot's firmware runs through the drivers on the virtual LF2407A.

The host sends a new driving command every 50 ms, each unlike all others, sets and reads parameters,
and records at 100 rows a second. The bench looks into the robot: which commands it has held, which
parameters it has, how many frames it has sent.
"""

import argparse
import json
import threading
from collections import Counter

from link_bench import NoisyLine, robot
from omnislip.errors import RobotError
from omnislip.link import protocol
from omnislip.link.port import SerialLine
from omnislip.link.record import RECORD_STREAM, Recorder
from omnislip.link.session import Session
from omnislip.virtual_robot import VirtualLine, pseudo_terminal, serve

PROBABILITY = 0.01
COMMAND_PERIOD_S = 0.05
TUNED = "position_gain_q20"
MODES = {name: number for number, name in enumerate(protocol.MODES)}


class Witness:
    """A robot whose held commands are written down."""

    def __init__(self, on_board=False):
        self.robot = robot(on_board=on_board)
        self.held = []
        self.end = False

    def __getattr__(self, name):
        return getattr(self.robot, name)

    def advance(self, ticks, sent):
        if self.end:
            raise KeyboardInterrupt
        came = self.robot.advance(ticks, sent)
        self.held += [(mode, tuple(value)) for _, mode, value in self.robot.commands]
        return came


def toward_zero(numerator, denominator):
    return int(numerator / denominator)


def command(number):
    """The request of command `number`, and what the robot holds when it carries it out."""
    if number % 2:
        fine, coarse = number % 200, number // 200
        duty = [fine - 100, coarse - 50, -fine, 7]
        names = protocol.REQUESTS["duty"].fields.names
        return "duty", dict(zip(names, duty, strict=True)), (MODES["DUTY"], (*duty, 0, 0))
    fine, coarse = number % 200, number // 200
    velocity = [fine + 1, coarse + 1, 5]
    names = protocol.REQUESTS["velocity"].fields.names
    held = (
        toward_zero(velocity[0] * 1024, 125),
        toward_zero(velocity[1] * 1024, 125),
        toward_zero(velocity[2] * 256, 125),
    )
    fields = dict(zip(names, velocity, strict=True))
    return "velocity", fields, (MODES["VELOCITY"], (*held, 0, 0, 0))


class Talk:
    """The host's side of the experiment."""

    def __init__(self, session):
        self.session = session
        self.offered, self.set_values = [], []
        self.parameters_wrong = self.given_up = self.refused = 0

    def run(self, duration_s):
        begin_s = self.session.line.time_s()
        self.session.request("arm")
        number = 0
        while self.session.line.time_s() < begin_s + duration_s:
            number += 1
            due_s = begin_s + number * COMMAND_PERIOD_S
            self.offer(number)
            if number % 20 == 0:
                self.tune(number)
            self.session.listen(due_s - self.session.line.time_s())

    def offer(self, number):
        name, fields, held = command(number)
        self.offered.append(held)
        try:
            self.session.offer(name, COMMAND_PERIOD_S, **fields)
        except RobotError:
            self.refused += 1

    def tune(self, number):
        parameter = protocol.PARAMETERS[TUNED]
        try:
            self.session.request("parameter_set", id=parameter.id, value=number)
            self.set_values.append(number)
            read = self.session.request("parameter_get", id=parameter.id)["value"]
            self.parameters_wrong += read != number
        except RobotError:
            self.given_up += 1


def is_subsequence(some, of):
    rest = iter(of)
    return all(item in rest for item in some)


def experiment(line, witness, duration_s):
    """Return the figures of one run."""
    noisy = NoisyLine(line, PROBABILITY)
    session = Session(noisy)
    session.connect()
    recorder = Recorder(session, 100)
    recorder.start()
    talk = Talk(session)
    talk.run(duration_s)
    log, account = recorder.finish("noise")
    session.request("stop")
    sent_by_robot = witness.counters["stream_sequences"][RECORD_STREAM]
    held = [entry for entry in witness.held if entry[0] != MODES["IDLE"]]
    defaults = [p.default for p in protocol.PARAMETERS.values()]
    tuned = protocol.PARAMETERS[TUNED].id
    others = [v for n, v in enumerate(witness.parameters) if n != tuned]
    return {
        "duration_s": duration_s,
        "bytes": {"to_robot": noisy.to_robot.bytes, "from_robot": noisy.from_robot.bytes},
        "bytes_per_s": (noisy.to_robot.bytes + noisy.from_robot.bytes) / duration_s,
        "damaged_bytes": noisy.to_robot.damaged_bytes + noisy.from_robot.damaged_bytes,
        "frames_to_robot": [noisy.to_robot.frames, noisy.to_robot.valid, noisy.to_robot.wrong],
        "frames_from_robot": [
            noisy.from_robot.frames,
            noisy.from_robot.valid,
            noisy.from_robot.wrong,
        ],
        "commands_offered": len(talk.offered),
        "commands_held": len(held),
        "commands_held_and_never_offered": sum((Counter(held) - Counter(talk.offered)).values()),
        "commands_in_order": is_subsequence(held, talk.offered),
        "refused": talk.refused,
        "parameters_set": len(talk.set_values),
        "parameters_wrong": talk.parameters_wrong,
        "other_parameters_changed": others != defaults[:tuned] + defaults[tuned + 1 :],
        "requests_given_up": talk.given_up,
        "record_frames_sent": sent_by_robot,
        "record_frames_received": account.received,
        "record_frames_missing": account.missing,
        "rows": len(log.t_s),
        "rows_by_time": round((log.t_s[-1] - log.t_s[0]) * 100) + 1,
        "session": vars(session.counters),
        "robot": witness.counters,
    }


def on_pseudo_terminal(witness, duration_s):
    """The experiment in real time."""
    with pseudo_terminal() as (master, port):
        body = threading.Thread(target=run_robot, args=(witness, master))
        body.start()
        line = SerialLine(port)
        try:
            return experiment(line, witness, duration_s)
        finally:
            line.close()
            witness.end = True
            body.join()


def run_robot(witness, master):
    try:
        serve(witness, master)
    except KeyboardInterrupt:
        return


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("duration_s", type=float)
    parser.add_argument("--pty", action="store_true")
    parser.add_argument("--on-board", action="store_true")
    given = parser.parse_args()
    witness = Witness(given.on_board)
    if given.pty:
        figures = on_pseudo_terminal(witness, given.duration_s)
    else:
        figures = experiment(VirtualLine(witness), witness, given.duration_s)
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
