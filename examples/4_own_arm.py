"""An arm of your own: one link on a horizontal axis, from its table to a controller, with a CSV
log in between.
"""

import tempfile

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import identify
from plant import (
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    Lumping,
    P,
    Record,
    Rig,
    simulate,
)

# Geometry: one row of the modified Denavit-Hartenberg table per joint. Gravity acts along -z of the
# base, so a twist of -90 degrees makes the axis horizontal.
chain = Chain(links=(Link(name="1", alpha=-np.pi / 2, a=0.0, d=0.0),))


# What f means. Of the 11 standard parameters of the link (`Lumping.standard(chain)`) only three
# combinations are identifiable: the inertia about the axis including the motor's, and the two first
# moments.
def lump(link):
    inertia = link.Izz + link.m * (link.x**2 + link.y**2)
    return {"f1": link.J + inertia, "f2": link.m * link.x, "f3": link.m * link.y}


lumping = Lumping.from_equation(lump, links=1, inertial=("f1",), gravitational=("f2", "f3"))
dynamics = Dynamics(chain=chain, lumping=lumping)

# The rig: drive (motor side), encoder, sampling period.
drive = Drive(
    gear=(100.0,),
    motor_inertia=(2e-4,),
    viscous=(1e-3,),
    coulomb=(0.1,),
    motor_gain=(0.2,),
    current_limit=(12.0,),
)
rig = Rig(drive=drive, encoder=Encoder(resolution=(1000,)), period=1e-3)
law = P(gain=(0.1,))  # [N m of motor torque per pulse], the gain of your position controller
path = Harmonics(period=3.0, offset=(0.3,), cosine=((-0.3,),), sine=((0.0,),))

# The true arm, known to the simulation alone; its log is a plain CSV of t, reference pulses, error
# pulses.
rotor = drive.reflected_inertia()[0]
truth = dynamics.arm(
    dynamics.f([Body(mass=8.0, com=(0.2, 0.01, 0.0), inertia=(0, 0, 0, 0, 0, 0.2), rotor=rotor)])
)
log = simulate(truth, rig, law, path, steps_per_sample=16)
with tempfile.TemporaryDirectory() as folder:
    np.savetxt(
        f"{folder}/my_robot.csv",
        np.column_stack([log.t, log.reference_pulses, log.error_pulses]),
        delimiter=",",
    )
    measured = Record.from_csv(f"{folder}/my_robot.csv", rig=rig, law=law)

# Ranges from a rough knowledge of the arm; equal ends would fix a value.
ranges = ((1.5, 4.0), (0.5, 3.0), (-0.5, 0.5))
found = identify(dynamics, measured, ranges=ranges, seed=1, progress=False)
for name, true, value in zip(dynamics.names, truth.f, found.f, strict=True):
    print(f"{name}: {value:.3f} found, {true:.3f} true")

report = evaluate(truth, rig, ComputedTorque(found), path)
print(report)
assert report.within(1)
