"""What FMUs are made from: our own parts, MuJoCo models, control laws, PythonFMU slaves."""
