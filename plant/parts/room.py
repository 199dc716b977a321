"""Whether what is asked for fits into the memory that is free: said before the work, not by the
kernel's end of it.
"""

import os
from pathlib import Path

_SHARE = 0.9  # of the free memory that one piece of work may want


def free_memory() -> float:
    """Bytes that this process may still take; infinite where the system does not say.

    What the machine has left, or the group of processes that this one belongs to, if it has a
    limit.
    """
    left = [float("inf")]
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                left.append(1024.0 * int(line.split()[1]))
    except (OSError, ValueError, IndexError):
        pass
    group = Path("/sys/fs/cgroup")
    try:
        most = (group / "memory.max").read_text(encoding="ascii").strip()
        if most != "max":
            left.append(float(most) - float((group / "memory.current").read_text(encoding="ascii")))
    except (OSError, ValueError):
        pass
    if (
        min(left) == float("inf")
        and hasattr(os, "sysconf")
        and "SC_AVPHYS_PAGES" in os.sysconf_names
    ):
        left.append(float(os.sysconf("SC_AVPHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    return min(left)


def require_room(what: str, samples: int, each: float, advice: str, *, fixed: float = 0.0) -> None:
    """Refuse work on so many samples that needs more memory than is free.

    `what`: the work, with its numbers, as a message says it; `each`: bytes that one sample takes at
    the peak, beside `fixed` ones; `advice`: what to do, with ``{most}`` for the number of samples
    that would fit.
    """
    needed = fixed + each * samples
    free = _SHARE * free_memory()
    if needed > free:
        most = max(0, int((free - fixed) / each))
        raise ValueError(
            f"{what} must fit into memory; it needs some {needed / 1e9:.2g} GB, and"
            f" {free / 1e9:.2g} GB are free. {advice.format(most=f'{most:,}')}"
        )
