"""Check that work fits into the free memory, before the system ends the process for it."""

import os
from pathlib import Path

# Share of the free memory that one piece of work may need; the remainder is for the interpreter and
# other processes, and the estimates of the callers are rough. Chosen by hand.
_SHARE = 0.9


def free_memory() -> float:
    """Bytes that this process may still allocate; infinite where the system does not report it.

    The smaller of the free memory of the machine and that of the process group, if limited.
    """
    limits = [float("inf")]
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                limits.append(1024.0 * int(line.split()[1]))
    except (OSError, ValueError, IndexError):
        pass
    # A container may be limited to less than the machine has free (control groups, version 2).
    group = Path("/sys/fs/cgroup")
    try:
        group_limit = (group / "memory.max").read_text(encoding="ascii").strip()
        if group_limit != "max":
            limits.append(
                float(group_limit) - float((group / "memory.current").read_text(encoding="ascii"))
            )
    except (OSError, ValueError):
        pass
    # Systems without /proc may still report free pages.
    if (
        min(limits) == float("inf")
        and hasattr(os, "sysconf")
        and "SC_AVPHYS_PAGES" in os.sysconf_names
    ):
        limits.append(float(os.sysconf("SC_AVPHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    return min(limits)


def require_room(
    work: str, samples: int, bytes_per_sample: float, advice: str, *, fixed: float = 0.0
) -> None:
    """Refuse work on so many samples that needs more memory than is free.

    `work`: its description with its numbers, for the message; `bytes_per_sample`: memory of one
    sample at the peak, beside `fixed` bytes; `advice`: what to do, with ``{most}`` for the number
    of samples that would fit.
    """
    needed = fixed + bytes_per_sample * samples
    free = _SHARE * free_memory()
    if needed > free:
        samples_that_fit = max(0, int((free - fixed) / bytes_per_sample))
        raise ValueError(
            f"{work} must fit into memory; it needs some {needed / 1e9:.2g} GB, and"
            f" {free / 1e9:.2g} GB are free. {advice.format(most=f'{samples_that_fit:,}')}"
        )
