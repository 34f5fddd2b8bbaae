"""A slave for PythonFMU. Its class becomes an FMU when the scenario is run.

For other tools, `pythonfmu build -f my_slave.py` makes Gust.fmu of it.
"""

from math import pi, sin

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Gust(Fmi2Slave):
    """Wind that swings from side to side: a force on the hand."""

    def __init__(self, **settings):
        super().__init__(**settings)
        self.strength = 5.0  # N
        self.period = 1.5  # s
        self.force = 0.0  # N, along the world's y axis
        tunable = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("strength", **tunable))
        self.register_variable(Real("period", **tunable))
        self.register_variable(Real("force", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        """Called for every step; sets the outputs at its end."""
        self.force = self.strength * sin(2 * pi * (time + step) / self.period)
        return True
