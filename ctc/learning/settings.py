"""Numbers of `learn`."""

from plant.parts import Settings, part


@part
class LearnSettings(Settings):
    """Settings of `learn`; all were chosen by hand, and tests/benchmarks/learn.py tests them.

    Parameters
    ----------
    gain : float
        Share of the missing torque by which a repetition corrects the learnt one.
    must_fall : float
        Share of the previous missing torque above which a correction did not help.
    may_worsen : float
        Share of the samples that may newly be beyond ±1 pulse after a correction.
    settled : float
        Missing torque, as a share of the amplifier's limit, below which all is learnt.
    largest_innovation : float
        Mean normalised innovation above which a repetition is left out; 1 where log and model
        agree.
    innovation_ratio : float
        The same, over the smallest so far and 1.
    highest_frequency : float
        Of the learnt torque [Hz].
    largest_terms : int
        Largest number of cosine terms per joint.
    moving_speed : float
        Speed of the reference [pulses/s] from which on a joint moves; nothing is learnt below.
    stuck_bandwidth : float
        Bandwidth [rad/s] of the stiffness that gives a joint torque where it stands and should
        move.
    stuck_lead : float
        Lead of that torque [s].
    stuck_smoothing : float
        Standard deviation of the Gaussian that smooths it [s].
    f_deviation : float
        Relative standard deviation of f before, where no covariance is known.
    friction_deviation : float
        Relative standard deviation of friction before, likewise.
    correlation_time : float
        Time [s] over which the unexplained torque is correlated: two time constants of the
        smoother.
    elastic_limit : float
        (omega dt)^2 of links on their gears up to which Runge-Kutta 4 follows them; the gears are
        taken for rigid beyond. Its limit of stability is 8.
    halvings : int
        Halvings of a sample for its transition matrix, by Taylor's fourth order.
    smoother_bandwidth : float
        Bandwidth of the estimate of the missing torque [rad/s].
    standing_time : float
        Time [s] for which the count of a joint that sticks stays the same.
    standing_memory : float
        Time [s] for which friction of a joint that sticks is taken to stay the same.
    start_distance : float
        Distance [pulses] from the start of the path within which the law may be started.

    Raises
    ------
    ValueError
        A number that is negative or, where it must be positive, zero; a `gain` above 1.

    See Also
    --------
    ctc.learn

    Examples
    --------
    >>> from ctc import LearnSettings
    >>> LearnSettings(gain=0.5).gain
    0.5
    """

    may_be_zero = ("may_worsen", "settled", "moving_speed", "stuck_bandwidth", "stuck_lead")
    at_most = {"gain": 1}  # noqa: RUF012  # declared as of the class

    gain: float = 0.7
    must_fall: float = 0.8
    may_worsen: float = 0.005
    settled: float = 1e-3
    largest_innovation: float = 1.25
    innovation_ratio: float = 1.3
    highest_frequency: float = 40.0
    largest_terms: int = 400
    moving_speed: float = 3.0
    stuck_bandwidth: float = 14.0
    stuck_lead: float = 0.015
    stuck_smoothing: float = 0.008
    f_deviation: float = 0.05
    friction_deviation: float = 0.2
    correlation_time: float = 0.02
    elastic_limit: float = 4.0
    halvings: int = 3
    smoother_bandwidth: float = 100.0
    standing_time: float = 0.02
    standing_memory: float = 0.05
    start_distance: float = 3.0


SETTINGS = LearnSettings()
