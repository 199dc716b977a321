"""Time-optimal paths: the fastest time law within the amplifiers' limits, and its tracking error.

Three paths of the paper's arm: its trajectory (6), a point-to-point move, and a spline. For each:
the shortest duration by uniform scaling, the fastest time law along the same path, and the same
path uniformly scaled to that duration. All are run under computed torque with the true f; peak
share is the motion's peak torque over the amplifier's limit. The GIF of the first goes to figures/.
"""

from pathlib import Path

from ctc import ComputedTorque, animate, evaluate
from plant import PointToPoint, Spline, fastest, puma560

SHARE, RATE = 0.9, (5e3, 5e3)  # of the limit; N m/s

arm, rig = puma560.arm(), puma560.rig()
law = ComputedTorque(arm, rig, bandwidth=150)
PATHS = {
    "trajectory (6)": puma560.reference(),
    "point to point": PointToPoint(start=(0.0, 0.0), goal=(-1.0, 1.0), duration=1.0),
    "spline": Spline(times=(0, 0.5, 1, 1.5), points=((0, 0), (-0.5, 0.8), (-1, 0.2), (-0.3, 1.0))),
}


def row(name, motion, report):
    needed, at_limit = motion.torque_share(arm, rig).max(), report.saturation.max()
    verdict = f"{report.share_within(1):>8} {report.max_error_pulses.max():8.0f}"
    print(f"  {name:<28}{motion.duration:9.3f} {needed:11.0%} {verdict} {at_limit:10.1%}")


def main():
    print(
        f"{'':<30}{'time [s]':>9} {'peak share':>11} {'within 1':>8} {'peak':>8} {'at limit':>10}"
    )
    for name, path in PATHS.items():
        fast = fastest(arm, rig, path, share=SHARE, torque_rate=RATE)
        shortest = fastest(arm, rig, path, share=SHARE, uniform=True).duration
        print(name)
        motions = {
            "uniform, shortest": path.slowed(shortest / path.duration),
            "fastest time law": fast,
            "uniform, of that duration": path.slowed(fast.duration / path.duration),
        }
        reports = {kind: evaluate(arm, rig, law, motion) for kind, motion in motions.items()}
        for kind, motion in motions.items():
            row(kind, motion, reports[kind])
        assert reports["fastest time law"].within(1)
        assert not reports["uniform, of that duration"].within(1)
        if name == "trajectory (6)":
            Path("figures").mkdir(exist_ok=True)
            file = Path("figures", "fastest_path.gif")
            count = animate(
                reports["fastest time law"], file, arm=arm, tip=(0, -0.43, 0), speed=0.25
            )
            print(f"  {count} pictures in {file}")


if __name__ == "__main__":
    main()
