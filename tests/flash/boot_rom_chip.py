"""The boot ROM of a chip behind a pseudo-terminal: what the manual says it does, and damage.

Written from the description of the protocol, not from omnislip.flash.boot_rom.
"""

import os
import random
import threading
import tty


class Chip:
    """Listens in a thread from `start` to `stop`. `memory` is program memory, None: never written.

    Each byte that comes, and each echo, is lost or changed with a probability.
    """

    def __init__(self, damage=0.0, seed=1, answers=True):
        self._random = random.Random(seed)
        self.damage = damage
        self.answers = answers
        self.resets = self.damaged = 0
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._power_on()

    def start(self):
        self._thread.start()
        return self

    def stop(self):
        os.close(self._slave)
        self._thread.join(5.0)
        os.close(self._master)

    def reset(self):
        self.resets += 1
        self._power_on()

    def _power_on(self):
        self.memory = [None] * 0x10000
        self.running = None  # address of the program that has been started
        self._in_a_row = 0
        self._found = False
        self._bytes = []

    def _run(self):
        while True:
            try:
                came = os.read(self._master, 64)
            except OSError:
                return
            for byte in came:
                self._take(self._spoil(byte))

    def _spoil(self, byte):
        draw = self._random.random()
        if draw >= self.damage:
            return byte
        self.damaged += 1
        return None if draw < self.damage / 2 else byte ^ (1 << self._random.randrange(8))

    def _send(self, byte):
        byte = self._spoil(byte)
        if byte is not None:
            os.write(self._master, bytes([byte]))

    def _take(self, byte):
        if byte is None or self.running is not None or not self.answers:
            return
        if not self._found:
            self._in_a_row = self._in_a_row + 1 if byte == 0x0D else 0
            if self._in_a_row == 9:
                self._found = True
                self._send(0xAA)
            return
        self._bytes.append(byte)
        words = [high << 8 | low for high, low in zip(*[iter(self._bytes)] * 2, strict=False)]
        if len(words) >= 3 and len(self._bytes) % 2 == 0:
            self.memory[(words[0] + len(words) - 3) % 0x10000] = words[-1]
        if len(words) >= 2 and len(words) == 2 + words[1]:
            self.running = words[0]
        self._send(byte)  # last: who has the echo may ask what the chip did
