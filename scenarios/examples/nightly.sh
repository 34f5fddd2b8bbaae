#!/bin/sh
# A repository of five scenarios: tests on all cores, a nightly sweep as a gate, a failure that is kept.
# Needs `pip install pytest-xdist`. Usage: sh nightly.sh [NEW_FOLDER]
set -eu
folder=${1:-nightly_suite}
mkdir "$folder" && cd "$folder"

# 1. Five scenarios: two new ones, three that begin as copies of shipped ones.
panda-cosim new suite/lift
panda-cosim new suite/own_law --law
for name in push jacobi slow_controller; do panda-cosim new suite/my_$name --from $name; done

# 2. References: from now on, a change of any signal beyond its tube is a failure.
panda-cosim regress --scenarios suite --update --yes

# 3. On each commit: the suite and your own tests side by side, with JUnit for the CI.
cat > test_margins.py <<'END'
def test_a_heavier_block_is_lifted_too(scenario_run):
    run = scenario_run("suite/lift", {"plant.block_mass": 0.22})
    run.assert_success()
    assert run.recording["plant.hand_xpos[3]"].min() > 0.18  # m
END
pytest -n 2 test_margins.py suite --panda-scenarios suite --junitxml junit.xml

# 4. Each night: a sweep beside its scenario, which must have nine successes in ten. `regress` judges
# both; exit code 1 or 3 would end this script here.
cat > suite/lift/sweep.toml <<'END'
scenario = "."
design = "random"
samples = 20
seed = 1
min_success = 0.9
[vary."plant.block_mass"]  # kg
uniform = [0.14, 0.22]
END
panda-cosim regress --scenarios suite --report nightly

# 5. How far does it go? The hardest push becomes a scenario: a known limit, which the suite watches.
panda-cosim sweep suite/my_push --vary 'push[1].force[2]=50:200:4' --out limit
panda-cosim sweep report limit
panda-cosim sweep promote limit 3 suite/pushed_too_hard --expect failure
panda-cosim regress --scenarios suite --no-sweeps
