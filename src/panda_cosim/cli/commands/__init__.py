"""The commands: NAME is the function `command` in NAME.py, and a line in this table.

`panda-cosim --help` reads only the table. A command's module is imported when the command is
called, so it can import everything at its top.
"""

from __future__ import annotations

RUN, SCENARIOS, RESULTS, MACHINE = "Run", "Scenarios", "Results", "FMUs and this machine"

# name: (the panel it is listed in, its summary: the first line of the function's docstring)
COMMANDS = {
    "run": (RUN, "Run a scenario, record it and judge it."),
    "live": (RUN, "Run a scenario in real time, and interact with it in the browser."),
    "replay": (RUN, "Repeat a run of `live` or of a Session, bit for bit."),
    "regress": (RUN, "Run scenarios and compare each with its reference."),
    "sweep": (RUN, "Run a scenario many times with varied values, on all cores or a cluster."),
    "list": (SCENARIOS, "List the shipped scenarios."),
    "new": (SCENARIOS, "Create a scenario of your own, ready to run."),
    "check": (SCENARIOS, "Explain what is wrong with a scenario, before it is run."),
    "retime": (SCENARIOS, "Fit a scenario's times to the robot's limits."),
    "route": (SCENARIOS, "Plan a scenario's motion: any block, any place, past all obstacles."),
    "inputs": (SCENARIOS, "Write a scenario's commands as an FMI input file."),
    "view": (RESULTS, "Show a run in 3D in the browser: one page that needs no network."),
    "render": (RESULTS, "Redraw a run's video and contact sheet."),
    "plot": (RESULTS, "Plot a run's signals on one page."),
    "compare": (RESULTS, "Compare runs: parameters, verdicts, metrics and signals."),
    "export": (RESULTS, "Write a recording as CSV, or as MCAP for Foxglove and rerun."),
    "analyze": (RESULTS, "Measure the control loops: margins, Bode plots, a state-space model."),
    "build": (MACHINE, "Build the FMUs of a scenario, and Panda.ssp that connects them."),
    "mjcf2fmu": (MACHINE, "Build an FMU from any MuJoCo model, without run-time dependencies."),
    "info": (MACHINE, "Show the FMUs' variables and how they are connected."),
    "doctor": (MACHINE, "Show what is installed, what is missing, and how to get it."),
    "bench": (MACHINE, "Measure what a co-simulation step costs."),
}  # fmt: skip

# Commands in a module of another name: MODULE:FUNCTION.
ELSEWHERE = {
    "inputs": "new:inputs",
    "route": "retime:route",
    "view": "render:view",
    "mjcf2fmu": "build:mjcf2fmu",
    "replay": "run:replay",
    "list": "new:list_scenarios",
    "plot": "render:plot",
    "export": "render:export",
    "sweep report": "sweep:report",
    "sweep show": "sweep:show_one",
    "sweep compare": "sweep:compare",
    "sweep promote": "sweep:promote",
}
