"""What is doubtful in an identification, said as a Python warning: when it is found, and where it is used."""

from typing import Any

from identification.results.trust import warnings_of
from plant.parts.user_warning import warn


class IdentificationWarning(UserWarning):
    """What was found is in doubt.

    Given once by `identify`, and by each law that is built on the identification; ``found.warnings`` has the lines.
    ``warnings.simplefilter("error", IdentificationWarning)`` makes it an error. An arm and a rig, as in
    ``ComputedTorque(found.arm, found.rig)``, are taken as they are: so they are accepted.

    See Also
    --------
    identification.identify

    Examples
    --------
    >>> import warnings
    >>> from identification import IdentificationWarning
    >>> warnings.simplefilter("error", IdentificationWarning)    # what is in doubt stops a script
    >>> warnings.simplefilter("default", IdentificationWarning)
    """


def doubts(found: Any) -> list[str]:
    """The warnings of an `Identification`, without what is so with any log."""
    return warnings_of(found, always=False)


def warn_of_doubts(found: Any, user: str) -> None:
    """Warn if an `Identification` is in doubt; `user` is what takes it."""
    lines = doubts(found)
    if lines:
        what = "1 warning" if len(lines) == 1 else f"{len(lines)} warnings"
        warn(f"{user}: identified with {what}:\n" + "\n".join(f"- {line}" for line in lines), IdentificationWarning)
