"""The three packages must come from one place: other distributions called `plant` and `ctc` exist."""

from importlib.util import find_spec
from pathlib import Path


def check_siblings() -> None:
    """Refuse to work when `identification` or `ctc` would be imported from elsewhere than beside this package."""
    home = Path(__file__).resolve().parent.parent
    for name in ("identification", "ctc"):
        spec = find_spec(name)
        found = Path(spec.origin).resolve().parent.parent if spec and spec.origin else None
        if found != home:
            raise ImportError(
                f"package {name!r} must be beside {home / 'plant'}; it would be imported from "
                f"{found / name if found else 'nowhere'}. Uninstall the other distribution, or put {home} first."
            )
