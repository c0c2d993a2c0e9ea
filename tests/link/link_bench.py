"""A session with a virtual robot, and a line that damages bytes."""

import random
from collections import Counter

from omnislip.link.protocol import FrameReader
from omnislip.link.session import Session
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.virtual_robot import VirtualLine, make_robot

MODEL = read_model(NOMINAL_ROBOT)
NOTHING = b""


def robot(store=None, on_board=False):
    return make_robot(MODEL, store, on_board)


def session(line=None):
    """A connected session, by default with a robot just switched on."""
    talk = Session(line or VirtualLine(robot()))
    talk.connect()
    return talk


class Damage:
    """Replaces each byte of one direction by another, with a probability; watches the frames.

    `wrong` counts frames that are valid after the damage and were never sent.
    """

    def __init__(self, probability, seed):
        self._probability = probability
        self._random = random.Random(seed)
        self._clean, self._damaged = FrameReader(), FrameReader()
        self._sent = Counter()
        self.bytes = self.damaged_bytes = self.frames = self.valid = self.wrong = 0

    def __call__(self, data):
        spoilt = bytearray(data)
        for place, byte in enumerate(spoilt):
            if self._random.random() < self._probability:
                spoilt[place] = (byte + self._random.randrange(1, 256)) % 256
                self.damaged_bytes += 1
        self._count(data, bytes(spoilt))
        return bytes(spoilt)

    def _count(self, clean, spoilt):
        self.bytes += len(clean)
        sent = self._clean.feed(clean)
        self.frames += len(sent)
        self._sent.update(sent)
        for content in self._damaged.feed(spoilt):
            self.valid += 1
            self.wrong += self._sent[content] == 0

    @property
    def broken(self):
        return self._damaged.broken


class NoisyLine:
    """A line that damages bytes on their way to the robot and back."""

    def __init__(self, line, probability, seed=1):
        self._line = line
        self.to_robot = Damage(probability, seed)
        self.from_robot = Damage(probability, seed + 1)

    def write(self, data):
        self._line.write(self.to_robot(data))

    def read(self, timeout_s):
        return self.from_robot(self._line.read(timeout_s))

    def time_s(self):
        return self._line.time_s()
