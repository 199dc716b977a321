"""Order of the files: the longest first, so that no worker begins one of them when the other is
done.

Files go to workers as a whole (`--dist loadfile` in pyproject.toml): fixtures of a module are made
once. Each worker is one thread for linear algebra: two that wait for each other on a shared core
take twice the time of an identification.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is loaded

LONGEST = (
    "test_commandline",
    "test_examples_of_the_reference",
    "test_methods",
    "test_tune",
    "test_stepwise",
    "test_effects",
    "test_plots",
    "test_c_running",
    "test_springs",
    "test_logged_load",
    "test_gears",
    "test_elastic",
    "test_guards",
    "test_replayed",
    "test_model_laws",
    "test_certify",
    "test_coupling",
    "test_real_data",
    "test_any_arm",
    "test_stick_slip_reference",
    "test_pid",
    "test_report",
    "test_procedure",
    "test_conditions",
    "test_learn",
)
"""By processor time from an empty kernel cache; those not named take less than 20 s each."""


def pytest_collection_modifyitems(items):
    place = {name: i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))
