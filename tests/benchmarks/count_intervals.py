"""A count is an interval: what a likelihood of quantisation cells gains over least squares.

    python tests/benchmarks/count_intervals.py [--seeds 20]

One joint in gravity, encoder of 400 counts per turn of its motor, gear 10, swings for 4 s under a
known torque of five random harmonics. Its position is read at 125 to 2,000 Hz, with noise of so
many counts before it is rounded: white, or slow (below 2 Hz), as what a model lacks is. Unknown: f,
viscous friction and the phase of the counter. All errors are small, so the position is linear in
them (slopes by `replay`). Compared, by the errors of the values (rms over the seeds), with least
squares on the counts:
- cells: the middle of the range of each value over all values that explain every count (no noise);
- likelihood: the maximum of the probability of the cells, under white noise of the size it has.
"""

import argparse

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import linprog, minimize
from scipy.special import log_ndtr

from plant import Chain, Drive, Dynamics, Encoder, Link, LoggedTorque, Record, Rig, replay

COUNTS, GEAR = 400.0, 10.0  # per turn of the motor; gear
PERIOD, SECONDS = 5e-4, 4.0
TRUE = {"mass": 2.0, "centre": 0.3, "inertia": 0.25, "viscous": 0.4}  # kg, m, kg m^2, N m s/rad
HARMONICS = (0.25, 0.5, 0.75, 1.25, 1.75)  # [Hz]
RATES = (125, 250, 500, 1000, 2000)  # [Hz]
NOISES = (0.0, 0.01, 0.03, 0.1, 0.3)  # [counts]
SLOW = 0.1  # memory of slow noise [s]
STEP = 1e-3  # relative, of the differences

DYNAMICS = Dynamics.from_chain(Chain(links=(Link(name="joint"),), gravity=(0.0, -9.81, 0.0)))


def rig(viscous):
    drive = Drive(
        gear=(GEAR,), motor_inertia=(0.0,), motor_gain=(1.0,), current_limit=(np.inf,),
        viscous=(viscous / GEAR**2,), coulomb=(0.0,),
    )  # fmt: skip
    return Rig(drive=drive, encoder=Encoder(resolution=(COUNTS,)), period=PERIOD)


def f(values):
    """f of the dynamics, by name, of a body on its axis."""
    of = {"J_joint + Izz_joint": values[0], "mx_joint": values[1], "my_joint": values[2]}
    return np.array([of[name] for name in DYNAMICS.names])


def positions(values, torque):
    """True position [counts] along the torque."""
    t = PERIOD * np.arange(len(torque))
    machine = rig(values[3])
    log = Record(
        t=t, error_pulses=np.zeros((len(t), 1)), torque=torque, rig=machine, law=LoggedTorque(),
        initial=np.zeros((2, 1)),
    )  # fmt: skip
    run = replay(DYNAMICS.arm(f(values)), log, steps_per_sample=4)
    return run.true_q[:, 0] * GEAR * COUNTS / (2 * np.pi)


def experiment(random):
    """Position [counts], and its slopes (N, 4) per relative change of the values."""
    t = PERIOD * np.arange(round(SECONDS / PERIOD))
    phases = random.uniform(0, 2 * np.pi, len(HARMONICS))
    waves = np.cos(2 * np.pi * np.outer(t, HARMONICS) + phases)
    torque = waves.sum(axis=1)[:, None]
    moment = TRUE["mass"] * TRUE["centre"]
    # A little off the axis, so that no value is zero.
    values = np.array([TRUE["inertia"], 0.95 * moment, -0.2 * moment, TRUE["viscous"]])
    slopes = []
    for i in range(len(values)):
        step = STEP * np.eye(len(values))[i]
        ahead, behind = (positions(values * (1 + sign * step), torque) for sign in (1, -1))
        slopes.append((ahead - behind) / (2 * STEP))
    # The last column is the phase of the counter.
    slopes.append(np.ones(len(t)))
    return positions(values, torque), np.array(slopes).T


def cells(slopes, error):
    """Middle of the range of each value; NaN where no values explain all counts."""
    scale = np.abs(slopes).max(axis=0)
    rows = np.vstack([slopes, -slopes]) / scale
    limits = np.concatenate([error + 0.5, 0.5 - error])
    ends = []
    for i in range(slopes.shape[1]):
        for sign in (1, -1):
            goal = sign * np.eye(slopes.shape[1])[i]
            found = linprog(goal, rows, limits, bounds=(None, None), method="highs")
            ends.append(found.x[i] if found.success else np.nan)
    return np.reshape(ends, (-1, 2)).mean(axis=1) / scale


def likelihood(slopes, error, noise, start):
    """Values of the largest probability of the cells under white noise [counts]."""
    scale = np.sqrt(np.linalg.inv(slopes.T @ slopes).diagonal()) * 0.3

    def cost(step):
        centre = (error - slopes @ (start + scale * step)) / noise
        high, low = centre + 0.5 / noise, centre - 0.5 / noise
        # Of the two tails the smaller, so that no difference of ones is taken.
        turned = low > 0
        high, low = np.where(turned, -low, high), np.where(turned, -high, low)
        above, below = log_ndtr(high), log_ndtr(low)
        inside = above + np.log1p(-np.exp(np.minimum(below - above, -1e-16)))
        density_high, density_low = (
            np.exp(-(x**2) / 2 - inside) / np.sqrt(2 * np.pi) for x in (high, low)
        )
        pull = np.where(turned, -1, 1) * (density_high - density_low)
        return -inside.sum(), (slopes * scale).T @ pull / noise

    # Outside of every cell the slope is huge: from wide noise to the right one.
    found = minimize(cost, np.zeros(len(start)), jac=True, method="BFGS")
    return start + scale * found.x


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    given = parser.parse_args()
    errors = {}
    for seed in range(given.seeds):
        random = np.random.default_rng(seed)
        position, slopes = experiment(random)
        position = position + random.uniform(-0.5, 0.5)
        white = random.normal(size=position.shape)
        slow = gaussian_filter1d(random.normal(size=position.shape), SLOW / PERIOD)
        cases = [(rate, "none", 0.0, white) for rate in RATES]
        for noise in NOISES[1:]:
            cases.append((RATES[-2], "white", noise, white))
            cases.append((RATES[-2], "slow", noise, slow / slow.std()))
        for rate, kind, noise, shape in cases:
            rows = slice(None, None, round(1 / (rate * PERIOD)))
            error = np.round(position + noise * shape)[rows] - position[rows]
            plain = np.linalg.lstsq(slopes[rows], error, rcond=None)[0]
            other = (
                likelihood(slopes[rows], error, noise, plain)
                if noise
                else cells(slopes[rows], error)
            )
            errors.setdefault((rate, kind, noise), []).append((plain[:-1], other[:-1]))
    print("| Hz | samples | noise [counts] | least squares [%] | cells, likelihood [%] | sharper |")
    print("|---|---|---|---|---|---|")
    for (rate, kind, noise), pairs in errors.items():
        plain, other = 100 * np.sqrt(np.nanmean(np.square(pairs), axis=0))
        ratio = np.exp(np.mean(np.log(plain / other)))
        columns = (", ".join(f"{value:.2g}" for value in values) for values in (plain, other))
        print(
            f"| {rate} | {round(rate * SECONDS)} | {kind} {noise:g} | {' | '.join(columns)} | {ratio:.2g} |"
        )


if __name__ == "__main__":
    main()
