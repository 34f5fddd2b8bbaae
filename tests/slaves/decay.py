"""A slave of a user's own on PythonFMU's interface, with a helper beside it."""

import my_helper
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String


class Decay(Fmi2Slave):
    """Integrates twice its input; fails when it is told to."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.x, self.n, self.on = 1.0, 0.0, 3, True
        self.text, self.echo, self.fail, self.big = "abc", "", 0.0, 0
        given = {"causality": Fmi2Causality.input}
        computed = {"causality": Fmi2Causality.output}
        tunable = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("u", **given))
        self.register_variable(Real("x", **computed))
        self.register_variable(Integer("n", **tunable))
        self.register_variable(Boolean("on", **tunable))
        self.register_variable(String("text", **tunable))
        self.register_variable(String("echo", **computed))
        self.register_variable(Real("fail", **given))
        self.register_variable(Integer("big", **computed))

    def do_step(self, current_time, step_size):
        """Integrate."""
        if self.fail == 2.0:
            return False
        if self.fail:
            raise RuntimeError("boom 100%")
        self.x += my_helper.double(self.u) * step_size * self.n * self.on
        self.echo = self.text + "!"
        self.big = int(1e9 * self.u)
        return True
