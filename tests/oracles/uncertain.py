"""Options of `certify` and `tune` in one dictionary: what belongs to an `Uncertainty` becomes
one.
"""

import dataclasses

from ctc import Uncertainty


def with_uncertainty(**options):
    """The options, with an uncertainty of those that are its fields."""
    names = [field.name for field in dataclasses.fields(Uncertainty) if field.name in options]
    return {"uncertainty": Uncertainty(**{name: options.pop(name) for name in names}), **options}
