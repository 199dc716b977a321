"""Functions that undo a mistake in the statement of a log or a chain, or suggest its size.

A function with the arguments `equation`, `joints` and `size` returns the equation without the
mistake; one with `record` in its place corrects the record. One without `size` returns the sizes
that the log suggests, some of them with evidence: the logarithm of how much likelier a size makes
the log.
"""

import math
from dataclasses import replace

import numpy as np

from identification.equation_error.law_gains import own_numbers, with_numbers
from identification.equation_error.regressor import regressor_along
from identification.equation_error.stated_equation import SETTINGS
from identification.equation_error.stated_law import variants_of
from plant.checkup import counts_in_time as counts_earlier
from plant.checkup import exchanged_torques, turned_joint, zero_shifted
from plant.motion import Motion


def _signs(n, joint):
    """Signs (n,), one joint's turned."""
    return np.where(np.arange(n) == joint, -1.0, 1.0)


def turned(equation, joints, size):
    """The joint with all its columns turned."""
    if _runs_law(equation):
        return _anew(equation, turned_joint(equation.record, joints, size))
    sign = _signs(equation.dynamics.n, *joints)
    motion = Motion(*(sign * signal for signal in equation.motion))
    return equation.restated(motion=motion, torque=sign * equation.torque, dry=sign * equation.dry)


def torque_turned(equation, joints, size):
    """The joint with its torque alone turned."""
    return equation.with_torque(_signs(equation.dynamics.n, *joints) * equation.torque)


def torques_turned(equation, joints, size):
    """All torques turned."""
    return equation.with_torque(-equation.torque)


def gravity_times(equation, joints, size):
    """Gravity times a factor: -1 is upwards."""
    return equation.restated(gravity=size)


def weighed(equation, joints, size):
    """Without gravity if `size` is 0; else with `size` times the stated bodies' weight added."""
    if not size:
        return equation.restated(gravity=0.0)
    dynamics = equation.dynamics
    resting = Motion(equation.motion.q, *2 * [0 * equation.motion.q])
    Y = regressor_along(dynamics, equation.rig, dynamics.names, resting)[0]
    # Residuals keep the log's unit: the added torque, which is well explained, would enlarge the
    # unit and so make the residuals look smaller.
    heavier = equation.restated(unit=1 / np.maximum(equation.of_joints[2].max(axis=0), 1e-300))
    return heavier.with_columns(equation.columns, equation.needed).with_torque(
        equation.torque + size * Y @ dynamics.f()
    )


def removals(equation, joints):
    """Sizes for `weighed`: 0 removes gravity, and 1 adds the weight of the bodies, if stated."""
    return (0.0,) if equation.needed is None else (0.0, 1.0)


def zero_moved(equation, joints, size):
    """The joint with another zero [degrees]."""
    if _runs_law(equation):
        return _anew(equation, with_zero(equation.record, joints, size))
    shift = np.zeros(equation.dynamics.n)
    shift[list(joints)] = np.deg2rad(size)
    return equation.restated(motion=equation.motion._replace(q=equation.motion.q - shift))


def with_zero(record, joints, size):
    """A record in which the joint has another zero [degrees]."""
    shift = np.zeros(record.n)
    shift[list(joints)] = np.deg2rad(size)
    return zero_shifted(record, shift)


def tilts(equation, joints):
    """The likeliest tilt of the base [degrees]; none of a level one, or without gravity."""
    if not any(equation.dynamics.chain.gravity):
        return ()
    degrees = float(np.rad2deg(np.hypot(*equation.likeliest_tilt)))
    return (degrees,) if degrees > SETTINGS.level else ()


def levelled(equation, joints, size):
    """The base tilted as is likeliest."""
    return equation.restated(tilt=equation.likeliest_tilt)


def without_friction(equation, joints, size):
    """Torques whose friction is known to be less than the stated one."""
    return equation.restated(frictionless=True).with_columns(equation.columns, equation.needed)


def frictionless(equation, joints):
    """Friction's share of logged torques [%], if below the expected one, and the evidence."""
    return () if equation.commanded else _less_friction(equation)


def overstated(equation, joints):
    """As `frictionless`, of the torques of a law, which overcome the friction as well."""
    return _less_friction(equation) if equation.commanded else ()


def _less_friction(equation):
    stated = SETTINGS.usual if equation.rig.drive.left_open else equation.braking
    if equation.frictionless or stated < SETTINGS.braked:
        return
    share = max(abs(equation.fitted.power), 1e-3)
    if share < stated:
        yield 100 * share, 0.5 * (math.log(share / stated) / SETTINGS.friction) ** 2


def scaled(equation, joints, size):
    """Torques in a unit so many times as large."""
    return equation.with_torque(equation.torque / size)


def scales(equation, joints):
    """The ratio of the torques to those that the stated bodies need, and its evidence."""
    if equation.needed is None or not equation.scale:
        return
    # A ratio within the usual error of the stated bodies is no evidence of another unit.
    usual = float(np.clip(equation.scale, 1 / SETTINGS.scale, SETTINGS.scale))
    # Nor is one where the log is explained as well without the bodies.
    less_likely = max(map(equation.evidence_of_bodies, (usual, 0.0)))
    yield equation.scale, equation.evidence_of_bodies(equation.scale) - less_likely


def units(equation, joints):
    """Units per radian (degrees, turns) that leave enough motion for an identification."""
    reach = np.rad2deg(np.ptp(equation.motion.q, axis=0).max())
    return tuple(unit for unit in (180 / np.pi, 0.5 / np.pi) if reach / unit > SETTINGS.reach)


def in_unit(equation, joints, size):
    """Positions that were read in a unit so many times too large."""
    return equation.restated(motion=Motion(*(signal / size for signal in equation.motion)))


def _exchanged(signal, joints):
    places = np.arange(signal.shape[1])
    places[list(joints)] = joints[::-1]
    return signal[:, places]


def positions_exchanged(equation, joints, size):
    """Positions of two joints exchanged, with the friction that follows from them."""
    motion = Motion(*(_exchanged(signal, joints) for signal in equation.motion))
    return equation.restated(motion=motion, dry=_exchanged(equation.dry, joints))


def torques_exchanged(equation, joints, size):
    """Torques of two joints exchanged."""
    return equation.with_torque(_exchanged(equation.torque, joints))


def with_torques_exchanged(record, joints, size):
    """A record with the torques of two joints exchanged, on the joints' side."""
    return exchanged_torques(record, joints, 0.0)


def in_time(equation, joints, size):
    """Torques that were logged so many milliseconds late."""
    # What wraps around lies outside the rows that are compared.
    return equation.with_torque(np.roll(equation.torque, -_samples(equation, size), axis=0))


def counts_in_time(equation, joints, size):
    """Counts that were so many samples late; the torque of the law follows from them anew."""
    return _anew(equation, counts_earlier(equation.record, joints, size))


def counts_lateness(equation, joints):
    """Delay of the counts [samples], where a law with memory read them, and its evidence.

    A law without memory turns late counts into viscous friction, which is fitted in any case.
    """
    if not _runs_law(equation):
        return

    def unlikely(size):
        return equation.evidence - counts_in_time(equation, joints, size).evidence_at_best

    size, least = _likeliest(unlikely, (0.0, *SETTINGS.counted_late), SETTINGS.counted)
    # Counts that are interpolated have less noise of rounding, whatever the direction of the shift:
    # the opposite shift is the reference.
    early = equation.evidence - unlikely(-size)
    yield size, equation.evidence - least - max(equation.evidence, early)


def _likeliest(unlikely, trials, tolerance):
    """The likeliest size near one of some trials but the first and last, and how unlikely it is."""
    # It is slow to import.
    from scipy.optimize import minimize_scalar

    best = 1 + int(np.argmin([unlikely(size) for size in trials[1:-1]]))
    nearest = trials[best - 1], trials[best + 1]
    options = {"xatol": tolerance}
    refined = minimize_scalar(unlikely, bounds=nearest, method="bounded", options=options)
    return float(refined.x), float(refined.fun)


def with_larger_gain(equation, joints, size):
    """The main gain of the law larger by so many per cent, and the torque anew."""
    if equation.gains_of_joints:
        return equation.with_open_gains
    return _anew(equation, with_gain(equation.record, equation.main_gain.name, size))


def record_with_gain(record, joints, size):
    """A record whose law has a main gain that is larger by so many per cent."""
    return with_gain(record, next(iter(own_numbers(record.law))), size)


def with_gain(record, name, size):
    """A record whose law has a number larger by so many per cent."""
    names = own_numbers(record.law)[name]
    return replace(record, law=with_numbers(record.law, 1 + size / 100, names))


def other_gain(equation, joints):
    """Per cent by which the main gain of the law may be larger, and the evidence."""
    if not _runs_law(equation) or equation.main_gain is None or equation.open_gains:
        return
    if equation.gains_of_joints:
        # Friction of more power than the torques: the log is too short for it, and for a gain.
        if abs(equation.fitted.power) > 1:
            return
        opened = equation.with_open_gains
        yield 100 * opened.fitted.gain, opened.evidence - equation.evidence
        return

    def unlikely(size):
        return equation.evidence - with_larger_gain(equation, joints, size).evidence

    size, least = _likeliest(unlikely, SETTINGS.changed, SETTINGS.refined_change)
    yield size, -least - SETTINGS.drift


def other_variants(equation, joints):
    """The place of each variant of the law, and the evidence for it.

    Friction that a law compensates is among the torques that it commands.
    """
    limited = _limited(equation)
    for place, text in enumerate(_variants(equation)):
        # A law that is hardly ever at its limit does not show what it does there.
        if text.startswith("anti_windup") and limited < SETTINGS.limited:
            continue
        other = with_variant(equation, joints, place)
        # One that is mostly at its limit gives a constant torque, which any f and offset explain.
        if _limited(other) > SETTINGS.mostly_limited:
            continue
        known = _unlikely_friction(equation) - _unlikely_friction(other)
        yield place, known + other.evidence_at_best - equation.evidence


def _limited(equation):
    """Share of the rows at which a law is at its limit, of the joint with the largest."""
    limit = equation.rig.drive.torque_limit()
    return np.mean(np.abs(equation.torque) > SETTINGS.near_limit * limit, axis=0).max()


def _unlikely_friction(equation):
    return max((evidence for _, evidence in _less_friction(equation)), default=0.0)


def with_variant(equation, joints, size):
    """The variant of the law at that place, and its torque anew."""
    return _anew(equation, record_with_variant(equation.record, joints, size))


def record_with_variant(record, joints, size):
    """A record whose law is the variant at that place."""
    return replace(record, law=[*variants_of(record.law, record.n).values()][size])


def _variants(equation):
    """Texts of the variants of a law that was run along its log."""
    return [*variants_of(equation.record.law, equation.dynamics.n)] if _runs_law(equation) else []


def words_of(equation, size):
    """Fields of a sentence: the main gain, the variant at the place that is the size, gravity."""
    main_gain = equation.main_gain
    # The likeliest tilt is tried of every arm with weight, and known here.
    weighs = any(equation.dynamics.chain.gravity)
    return {
        "gravity": _vector(equation.likeliest_gravity) if weighs else "",
        "gain": "" if main_gain is None else main_gain.name,
        "variant": dict(enumerate(_variants(equation))).get(size, ""),
    }


def _vector(components):
    # Adding 0 makes -0.00 a 0.00.
    return ", ".join(f"{round(x, 2) + 0.0:.2f}" for x in components.tolist())


def cut_off(equation, joints, size):
    """The torques of a law, limited as is likeliest."""
    return equation.cut_off(equation.likeliest_limits)


def limits(equation, joints):
    """The lowest limit as a share [%] of the largest torque that the law commands, if any."""
    if not _of_law(equation):
        return ()
    largest = np.abs(equation.signals.motor_torque).max(axis=0)
    share = np.min(equation.likeliest_limits[largest > 0] / largest[largest > 0], initial=1.0)
    return (100 * share,) if share < 1 else ()


def _of_law(equation):
    """Whether the torque is that of a law, from the counts of a log."""
    return equation.commanded and equation.record is not None


def _runs_law(equation):
    """Whether the torque is that of a law with memory, which was run along a log."""
    return _of_law(equation) and equation.constant


def _anew(equation, record):
    """The equation of another record of the same arm: the torque of its law follows anew."""
    anew = type(equation).of(equation.dynamics, record)
    return replace(anew, open_gains=equation.open_gains)


def _samples(equation, milliseconds):
    return round(1e-3 * milliseconds / equation.rig.period)


def late_positions(equation, joints, size):
    """Positions that were logged so many milliseconds late."""
    return in_time(equation, joints, -size)


def torques_lateness(equation, joints):
    """Times [ms] by which logged torques may be late, and the evidence, summed over the joints."""
    return [] if equation.commanded else _latenesses(equation, joints, 1)


def lead_over_law(equation, joints):
    """As `torques_lateness`, of a law's torques: those of the machine lead them."""
    return _latenesses(equation, joints, 1) if equation.commanded else []


def positions_lateness(equation, joints):
    """The same of positions, against which torques are early."""
    return _latenesses(equation, joints, -1)


def _latenesses(equation, joints, sign):
    """Times [ms] by which torques may be late (`sign` 1) or early (`sign` -1), and their evidence.

    Each joint counts by the logarithm of its residual. A joint with little friction reveals the
    time; one whose torque is mostly friction does not, and it has the largest residual.
    """

    def joint_by_joint(equation):
        return np.log(equation.fitted.left_by_joint + SETTINGS.floor).sum()

    as_stated = joint_by_joint(equation)
    # A short log leaves fewer samples at its ends.
    margin = min(equation.rows[0], len(equation.torque) - 1 - equation.rows[-1])
    for size in SETTINGS.late:
        if sign * size < 0:
            continue
        # A shift of less than two samples is no mistake: a logger may lag and hold by one each.
        if not 2 <= abs(_samples(equation, size)) <= margin:
            continue
        gain = as_stated - joint_by_joint(in_time(equation, joints, size))
        yield sign * size, SETTINGS.by_joint * gain
