"""Fills the tank of `listener.py`: ADDRESS, number of steps, and what it does then."""

import socket
import subprocess
import sys
import time

from filler_goal import GOAL

address, steps, then = sys.argv[1:]
if then == "absent":
    raise LookupError("no time today")
input("Press Enter to fill the tank")
with socket.create_connection((address, 14337)) as connection:
    lines, level = connection.makefile("rw"), 0.0
    for _ in range(int(steps)):
        lines.write(f"{20.0 * (GOAL - level)!r}\n")
        lines.flush()
        level = float(lines.readline())
    print(f"filled by {address} to {level:.3f} m")
    if then == "hang":
        child = subprocess.Popen(["sleep", "300.5"])
        print(f"sleeping {child.pid}", flush=True)
        time.sleep(300)
    if then == "fail":
        raise RuntimeError("the tank leaks")
