"""A host in Python that needs no package: it steps an FMU by ctypes, and prints its outputs.

    python bare_host.py FOLDER MODEL STEPS

FOLDER is the unpacked FMU (FMI 2.0). Exit code 2: it cannot be instantiated; the log says why.
"""

# No type hints and no newer syntax: it runs in any Python 3.
import ctypes
import re
import sys
from ctypes import c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = [("logger", LOGGER), *((name, c_void_p) for name in ("make", "free", "end", "env"))]


def main(folder, model, steps):
    """Step the FMU; returns its outputs."""
    text = Path(folder, "modelDescription.xml").read_text(encoding="utf-8")
    scalars = [v for v in re.findall("<ScalarVariable[^>]*>", text) if 'causality="output"' in v]
    references = [int(re.search('valueReference="([0-9]+)"', v).group(1)) for v in scalars]
    token = re.search('guid="([^"]*)"', text).group(1).encode()
    log = Callbacks(LOGGER(lambda _e, _n, _s, _c, said: print(said.decode(), file=sys.stderr)))
    fmi = ctypes.CDLL(str(Path(folder, "binaries", "linux64", model + ".so")))
    fmi.fmi2Instantiate.restype = c_void_p
    uri = ("file://" + folder + "/resources").encode()
    it = fmi.fmi2Instantiate(b"it", 1, token, uri, ctypes.byref(log), 0, 0)
    if not it:
        sys.exit(2)
    it = c_void_p(it)
    assert not fmi.fmi2SetupExperiment(it, 0, c_double(0), c_double(0), 0, c_double(0))
    assert not fmi.fmi2EnterInitializationMode(it)
    assert not fmi.fmi2ExitInitializationMode(it)
    for i in range(steps):
        assert not fmi.fmi2DoStep(it, c_double(i * 0.001), c_double(0.001), 1)
    count, values = len(references), (c_double * len(references))()
    assert not fmi.fmi2GetReal(it, (c_uint * count)(*references), c_size_t(count), values)
    fmi.fmi2FreeInstance(it)
    return list(values)


if __name__ == "__main__":
    for value in main(sys.argv[1], sys.argv[2], int(sys.argv[3])):
        print(value.hex())
