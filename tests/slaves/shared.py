"""A slave that works on the memory of the values."""

import struct

import numpy as np


class Shared:
    """Integrates its input with numpy."""

    def __init__(self, **_kwargs):
        self.messages = []
        self.x = 0.0

    def share_values(self, values, texts):
        """Take the memory."""
        self.values, self.texts = np.frombuffer(values), texts

    def start(self, start_time):
        """Begin."""
        self.x = start_time
        self.tune()

    def tune(self):
        """Take the gain."""
        self.gain = float(self.values[2])

    def advance(self, count):
        """Integrate."""
        if self.values[0] > 100:
            self.messages.append((1, "the input is large"))
        if self.values[0] > 1000:
            raise ArithmeticError("too large")
        for _ in range(count):
            self.x += self.gain * self.values[0] * 0.001
        self.values[1] = self.x

    def get_state(self):
        """Its sum, and a third of it, which is rounded."""
        return struct.pack("<2d", self.x, self.x / 3.0)

    def set_state(self, state):
        """Restore it."""
        self.x, _ = struct.unpack("<2d", state)
