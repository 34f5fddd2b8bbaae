"""The plant: a Franka Emika Panda, a table and a block, simulated by MuJoCo.

Nothing in here knows of FMI. `plant.Plant` is stepped at 1 ms through preallocated buffers.
`parameters` needs no MuJoCo, so that a scenario can be read without it.
"""
