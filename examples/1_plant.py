"""The arm, its drives and its encoder: simulate the paper's experiment and analyse its log."""

import tempfile

import numpy as np

from plant import Record, linearise, modes, puma560, simulate

arm, rig, p = puma560.arm(), puma560.rig(), puma560.p_law()

# D and h of equation (1), at the start of trajectory (6): gravity pulls the arm down with some 100
# N m.
start = np.zeros(2)
print("D(0) =", arm.D(start).round(3).tolist(), "kg m^2")
print("h(0, 0) =", arm.h(start, start).round(1).tolist(), "N m")

# One encoder pulse is this much of each joint.
print(
    "one pulse =",
    np.abs(rig.cell_centre(np.array([3, 3])) - rig.cell_centre(np.array([2, 2]))).tolist(),
    "rad",
)

# The experiment: P control on trajectory (6), one sample every 0.7 ms.
record = simulate(arm, rig, p, puma560.reference())
print(record)
print("largest tracking error:", np.abs(record.error_pulses).max(axis=0).tolist(), "pulses")

# The oscillation in the error is the P loop's own mode, not a flexible joint.
spectrum = np.abs(np.fft.rfft(record.error_pulses * np.hanning(len(record))[:, None], axis=0))
frequency = np.fft.rfftfreq(len(record), rig.period)
band = frequency > 10
print(
    "the error oscillates at",
    frequency[band][spectrum[band].argmax(axis=0)].round(1).tolist(),
    "Hz",
)
for q in ([0.0, 0.0], [-np.pi / 4, np.pi / 4], [-np.pi / 2, np.pi / 2]):
    slow, fast = modes(linearise(arm, rig, p, q))
    print(
        f"linearised at q = {np.round(q, 2).tolist()}: modes at {slow[0]:.1f} and {fast[0]:.1f} Hz,"
        f" damping ratio {slow[1]:.3f}"
    )

# A log can be written and read back without loss; a file from a real robot enters in the same way.
with tempfile.TemporaryDirectory() as folder:
    record.to_csv(f"{folder}/record.csv")
    assert np.array_equal(Record.from_csv(f"{folder}/record.csv").error_pulses, record.error_pulses)
