"""Exact confidence interval of a probability from counts (Clopper and Pearson)."""


def clopper_pearson(failures: int, samples: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval (low, high) of a probability, from how often something happened.

    ``clopper_pearson(k, n, 2 * c - 1)[1]`` is the one-sided upper bound at confidence c.
    """
    from scipy.special import betaincinv

    tail = (1 - confidence) / 2
    low = betaincinv(failures, samples - failures + 1, tail) if failures else 0.0
    high = betaincinv(failures + 1, samples - failures, 1 - tail) if failures < samples else 1.0
    return float(low), float(high)
