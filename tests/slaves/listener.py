"""A tank that listens: in each step, it waits for what a program lets flow in."""

import socket
import time

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String
from pythonfmu.enums import Fmi2Status


class Tank(Fmi2Slave):
    """The program sends a line with the flow for each step, and gets one with the level then."""

    def __init__(self, **settings):
        super().__init__(**settings)
        self.address, self.port, self.connection_timeout = "127.0.0.1", 14337, 0.0
        self.flow = self.level = 0.0
        self.server = self.lines = None
        fixed = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.fixed}
        self.register_variable(String("address", **fixed))
        self.register_variable(Integer("port", **fixed))
        self.register_variable(Real("connection_timeout", **fixed))
        self.register_variable(Real("flow", causality=Fmi2Causality.output))
        self.register_variable(Real("level", causality=Fmi2Causality.output))

    def exit_initialization_mode(self):
        """Listen."""
        self.server = socket.create_server((self.address, self.port))

    def do_step(self, current_time, step):
        """Wait for a line; if the program has left, the simulation ends."""
        line = (self.lines or self.accepted()).readline()
        if not line:
            self.log("the program has left", Fmi2Status.discard)
            return True
        self.flow = float(line)
        self.level += self.flow * step
        self.lines.write(f"{self.level!r}\n")
        self.lines.flush()
        return True

    def accepted(self):
        """Wait for the program, in slices."""
        deadline = time.monotonic() + (self.connection_timeout or 1e9)
        self.server.settimeout(0.1)
        while self.lines is None:
            try:
                connection, _ = self.server.accept()
                self.lines = connection.makefile("rw")
            except TimeoutError:
                if time.monotonic() > deadline:
                    raise ValueError(f"nobody came for {self.connection_timeout:g} s") from None
        return self.lines

    def terminate(self):
        """Close the door."""
        self.server.close()
