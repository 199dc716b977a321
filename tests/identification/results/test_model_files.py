"""Inertials written back: torques by pinocchio and MuJoCo, bytes that stay, f that no bodies
have.
"""

import dataclasses
import re
import warnings
from xml.etree import ElementTree

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import identify, write_model
from identification.results import Block, nearest_realisation
from plant import Body, Chain, Coupling, Dynamics, FrictionCurve, Harmonics, P, puma560, simulate
from plant.mechanics import from_pseudo_inertia, pseudo_inertia, symmetric_basis

pytest.importorskip("mujoco")
pytest.importorskip("pinocchio")
import mujoco
from model_texts import mjcf, mujoco_torques, pinocchio_torques, urdf

STATES = np.random.default_rng(0).uniform(-1, 1, (1000, 3, 4))


def with_rotors(chain, rotor):
    return dataclasses.replace(
        chain, bodies=tuple(dataclasses.replace(body, rotor=rotor) for body in chain.bodies)
    )


def another(chain, bodies, *, rotors=True, known=0.2, true=0.3):
    """The chain as somebody knows it, with the f of other bodies, and rotors that nobody knows
    exactly.
    """
    dynamics = Dynamics.from_chain(with_rotors(chain, known), rotors=rotors)
    return dynamics.arm(
        dynamics.f(with_rotors(dataclasses.replace(chain, bodies=bodies), true).bodies)
    )


def inertials_removed(text):
    return re.sub(
        r"<inertial>.*?</inertial>|<inertial .*?/>|armature=\"[^\"]*\"", "", text, flags=re.DOTALL
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    for i in range(2):
        (folder / f"{i}.urdf").write_text(urdf(i))
        (folder / f"{i}.xml").write_text(mjcf(i))
    return folder


@pytest.mark.parametrize("rotors", [True, False])
def test_urdf_has_the_torques_of_the_arm_in_both_engines(files, tmp_path, rotors):
    """Geometry of one robot, bodies of another; fixed branches, a link without inertial, turned
    inertial frames.
    """
    chain, target = Chain.from_urdf(files / "0.urdf"), tmp_path / "new.urdf"
    arm = another(chain, Chain.from_urdf(files / "1.urdf").bodies, rotors=rotors, true=0.3 * rotors)
    written = write_model(arm, files / "0.urdf", target)
    names = [link.name for link in chain.links]
    # rotors have no place in the file; of the first joint's, f shows the sum with its inertia alone
    expected = np.array([arm.inverse(*state) for state in STATES]) - written.rotors * STATES[:, 2]
    for engine in (pinocchio_torques, mujoco_torques):
        np.testing.assert_allclose(engine(target, names, STATES), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(written.rotors[1:], 0.3 * rotors, rtol=0, atol=1e-8)
    assert not written.difference.any()
    before, after = (files / "0.urdf").read_text(), target.read_text()
    assert before != after
    assert inertials_removed(after) == inertials_removed(before)
    for body in written.bodies.values():
        assert np.linalg.eigvalsh(pseudo_inertia(body.standard_parameters))[0] > 0


def test_mjcf_has_the_torques_of_the_arm_with_its_armature(files, tmp_path):
    chain, target = Chain.from_mjcf(files / "0.xml"), tmp_path / "new.xml"
    arm = another(chain, Chain.from_mjcf(files / "1.xml").bodies)
    written = write_model(arm, files / "0.xml", target)
    expected = np.array([arm.inverse(*state) for state in STATES])
    got = mujoco_torques(target, [link.name for link in chain.links], STATES)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    again = Chain.from_mjcf(target)
    np.testing.assert_allclose(
        [body.rotor for body in again.bodies], written.rotors, rtol=0, atol=0
    )
    # armature moved into joints
    strip = lambda text: re.sub(r"\s+", "", inertials_removed(text))  # noqa: E731
    assert strip(target.read_text()) == strip((files / "0.xml").read_text())
    assert target.read_text().count("<!-- body") == 5


def test_mjcf_of_a_urdf_has_the_torques_of_the_arm_with_its_armature(files, tmp_path):
    """Another format, the same joints: axes, fixed branches and prismatic joints; MuJoCo and this
    library read it.

    Its base hangs on a link called world, of which MJCF has its own.
    """
    source, target = tmp_path / "0.urdf", tmp_path / "new.xml"
    above = (
        '<link name="world"/><joint name="to_world" type="fixed"><parent link="world"/><child'
        ' link="l0"/></joint>'
    )
    source.write_text((files / "0.urdf").read_text().replace("</robot>", f"{above}</robot>"))
    chain = Chain.from_urdf(source)
    arm = another(chain, Chain.from_urdf(files / "1.urdf").bodies)
    written = write_model(arm, source, target)
    expected = np.array([arm.inverse(*state) for state in STATES])
    got = mujoco_torques(target, [link.name for link in chain.links], STATES)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
    again = Chain.from_mjcf(target)
    np.testing.assert_allclose(
        [body.rotor for body in again.bodies], written.rotors, rtol=0, atol=0
    )
    for name in ("lower", "upper", "effort"):
        np.testing.assert_array_equal(getattr(again.limits, name), getattr(chain.limits, name))
    model = mujoco.MjModel.from_xml_path(str(target))
    for link, effort in zip(chain.links, chain.limits.effort, strict=True):
        if np.isfinite(effort):
            assert model.jnt_actfrcrange[model.joint(link.name).id].tolist() == [-effort, effort]


def test_an_arm_of_the_file_itself_changes_no_byte(files, tmp_path):
    for name, read in (("0.urdf", Chain.from_urdf), ("0.xml", Chain.from_mjcf)):
        dynamics = Dynamics.from_chain(read(files / name))
        write_model(dynamics.arm(dynamics.f()), files / name, tmp_path / name)
        assert (tmp_path / name).read_bytes() == (files / name).read_bytes()


def test_suffix_of_the_target_is_its_format(files, tmp_path):
    dynamics = Dynamics.from_chain(Chain.from_urdf(files / "0.urdf"))
    write_model(dynamics.arm(dynamics.f()), files / "0.urdf", tmp_path / "new.XML")
    assert "<mujoco" in (tmp_path / "new.XML").read_text()
    dynamics = Dynamics.from_chain(Chain.from_mjcf(files / "0.xml"))
    with pytest.raises(ValueError, match=r"target must be MJCF, as its source is; got new.urdf"):
        write_model(dynamics.arm(dynamics.f()), files / "0.xml", tmp_path / "new.urdf")
    assert not (tmp_path / "new.urdf").exists()


def test_what_f_does_not_show_is_the_prior_s(files, tmp_path):
    """With the file of the truth as prior the truth is written, although f alone does not say
    it.
    """
    chain = Chain.from_urdf(files / "0.urdf")
    arm = another(chain, Chain.from_urdf(files / "1.urdf").bodies, rotors=False, true=0.0)
    random, truth = np.random.default_rng(1), tmp_path / "truth.urdf"
    first = write_model(arm, files / "0.urdf", truth)
    for prior in (truth, first.bodies):
        written = write_model(
            arm, files / "0.urdf", tmp_path / "a.urdf", prior=prior, overwrite=True
        )
        for name, body in written.bodies.items():
            np.testing.assert_allclose(
                body.standard_parameters, first.bodies[name].standard_parameters, rtol=0, atol=1e-12
            )
    # and of another prior something else is left
    other = {
        "tool": Body(mass=0.3, com=random.normal(size=3) * 0.1, inertia=(0.01, 0, 0, 0.01, 0, 0.01))
    }
    written = write_model(arm, files / "0.urdf", tmp_path / "b.urdf", prior=other)
    assert written.bodies["tool"].mass < 0.5 < first.bodies["tool"].mass
    assert not written.difference.any()


def test_f_that_no_bodies_have_is_refused_or_replaced_by_the_nearest(files, tmp_path):
    chain = Chain.from_urdf(files / "0.urdf")
    dynamics = Dynamics.from_chain(chain, rotors=False)
    f = dynamics.f()
    last = max(i for i, name in enumerate(dynamics.names) if name.startswith("Izz"))
    f[last] = -0.05  # about the last axis
    with pytest.raises(
        ValueError, match=r"f must be what bodies can have; .*Pass nearest=True"
    ) as error:
        write_model(dynamics.arm(f), files / "0.urdf", tmp_path / "no.urdf")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "no.urdf").exists()
    with pytest.warns(UserWarning, match=r"written are the nearest, which differ by .*Izz"):
        written = write_model(
            dynamics.arm(f), files / "0.urdf", tmp_path / "near.urdf", nearest=True
        )
    assert written.difference[last] > 0.05
    again = Chain.from_urdf(tmp_path / "near.urdf")
    np.testing.assert_allclose(dynamics.f(again.bodies), written.arm.f, rtol=0, atol=1e-9)


def test_refusals(files, tmp_path):
    chain = Chain.from_urdf(files / "0.urdf")
    dynamics = Dynamics.from_chain(chain)
    arm, target = dynamics.arm(dynamics.f()), tmp_path / "new.urdf"
    write_model(arm, files / "0.urdf", target)
    with pytest.raises(ValueError, match="target must be a new file"):
        write_model(arm, files / "0.urdf", target)
    write_model(arm, files / "0.urdf", target, overwrite=True)
    with pytest.raises(ValueError, match="another place or axis"):
        write_model(arm, files / "1.urdf", tmp_path / "x.urdf")
    with pytest.raises(ValueError, match="a folder that is there"):
        write_model(arm, files / "0.urdf", tmp_path / "gone" / "x.urdf")
    with pytest.raises(ValueError, match="got a Chain"):
        write_model(chain, files / "0.urdf", tmp_path / "x.urdf")
    with pytest.raises(ValueError, match=r"link of the prior must be one of .*Did you mean 'l1'"):
        write_model(
            arm, files / "0.urdf", tmp_path / "x.urdf", prior={"l11": Body(mass=1, com=(0, 0, 0))}
        )
    with pytest.raises(ValueError, match=r"links that the arm moves; it does not move l0"):
        write_model(
            arm, files / "0.urdf", tmp_path / "x.urdf", prior={"l0": Body(mass=1, com=(0, 0, 0))}
        )
    (tmp_path / "x.sdf").write_text("<sdf/>")
    with pytest.raises(ValueError, match="must hold a <robot> or a <mujoco>; got <sdf>"):
        write_model(arm, tmp_path / "x.sdf", tmp_path / "x.urdf")
    (tmp_path / "x.sdf").unlink()
    (tmp_path / "x.xacro").write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro/></robot>'
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new.urdf", "x.xacro"]


# -- the search ----------------------------------------------------------------------------------
def random_blocks(random, p):
    """Two bodies with random priors and random rows of f."""
    blocks = []
    for _ in range(2):
        L = np.linalg.cholesky(
            pseudo_inertia(
                Body(
                    mass=2, com=random.normal(size=3), inertia=(1, 0, 0, 1, 0, 1)
                ).standard_parameters
            )
        )
        blocks.append(Block(L, random.normal(size=(p, 10))))
    return blocks


def test_optimum_is_that_of_a_general_solver():
    """The same problem by scipy's trust region, which knows no Newton step of ours."""
    from scipy.optimize import minimize

    random = np.random.default_rng(3)
    blocks, f = random_blocks(random, 5), random.normal(size=5)
    matrices, reached = nearest_realisation(blocks, f)
    np.testing.assert_allclose(reached, f, rtol=0, atol=1e-11)

    def divergence(x):
        total = 0.0
        for part in np.split(x, 2):
            sign, logdet = np.linalg.slogdet(np.einsum("k,kij->ij", part, symmetric_basis(4)))
            total += np.trace(np.einsum("k,kij->ij", part, symmetric_basis(4))) - (
                logdet if sign > 0 else -1e6
            )
        return total

    A = np.column_stack([block.columns for block in blocks])
    x = np.concatenate(
        [
            np.einsum(
                "kij,ij->k",
                symmetric_basis(4),
                np.linalg.solve(b.factor, np.linalg.solve(b.factor, P).T),
            )
            for b, P in zip(blocks, matrices, strict=True)
        ]
    )
    assert np.allclose(A @ x, f)
    start = x + np.linalg.svd(A)[2][5:].T @ random.normal(size=15) * 0.02
    equations = {"type": "eq", "fun": lambda x: A @ x - f}
    options = {"ftol": 1e-14, "maxiter": 500}
    other = minimize(divergence, start, method="SLSQP", constraints=equations, options=options)
    np.testing.assert_allclose(other.x, x, rtol=0, atol=1e-5)
    assert divergence(x) <= other.fun + 1e-9


def test_nearest_f_of_a_pendulum():
    """f = (Izz, m x, m y) about its axis. No body has Izz < 0; near 0 there are heavy ones for
    any m x, m y.
    """
    body = Body(mass=1.0, com=(0.3, 0, 0), inertia=(0.1, 0, 0, 0.1, 0, 0.1))
    L = np.linalg.cholesky(pseudo_inertia(body.standard_parameters))
    rows = np.array([from_pseudo_inertia(L @ S @ L.T) for S in symmetric_basis(4)]).T[[9, 1, 2]]
    f = np.array([-0.05, 0.3, 0.0])
    assert nearest_realisation([Block(L, rows)], f) is None
    _, near = nearest_realisation([Block(L, rows)], f, np.eye(3))
    # the last softness leaves its square root
    np.testing.assert_allclose(near, [0.0, 0.3, 0.0], rtol=0, atol=1e-3)
    assert near[0] > 0


def test_pseudo_inertia_is_that_of_point_masses():
    random = np.random.default_rng(0)
    masses, places = random.uniform(0.1, 1, 7), random.normal(size=(7, 3))
    body = Body(mass=0.0, com=(0, 0, 0))
    for mass, place in zip(masses, places, strict=True):
        body = body.joined(Body(mass=mass, com=place))
    rows = np.column_stack([places, np.ones(7)])
    P = pseudo_inertia(body.standard_parameters)
    np.testing.assert_allclose(P, (rows * masses[:, None]).T @ rows, rtol=0, atol=1e-12)
    np.testing.assert_allclose(pseudo_inertia(from_pseudo_inertia(P)), P, rtol=0, atol=1e-15)


# -- motors --------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Files of a pendulum of two links, in each format, and it identified from the torque
    equation.
    """
    folder, rig, found = tmp_path_factory.mktemp("driven"), puma560.rig(), {}
    wide = urdf(7, kinds=("revolute", "revolute")).replace(
        'lower="-1" upper="1" effort="1"', 'lower="-3" upper="3" effort="400"'
    )
    path = Harmonics(
        period=2.0, offset=(0, 0), cosine=((0.4, 0.2), (0.2, -0.4)), sine=((0.1, 0.3), (-0.3, 0.1))
    )
    for name, text, read in (
        ("arm.urdf", wide, Chain.from_urdf),
        ("arm.xml", mjcf(7, kinds=("hinge", "hinge")), Chain.from_mjcf),
    ):
        (folder / name).write_text(text)
        dynamics = Dynamics.from_chain(read(folder / name).with_rotors(rig.drive))
        measured = simulate(
            dynamics.arm(dynamics.f() * 1.03), rig, P(gain=(0.5, 0.4)), path, backend="casadi"
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # f10 and f11 show their sum
            found[name] = identify(dynamics, measured, method="equation_error", progress=False)
    return folder, found


def written_to(driven, name, target, **options):
    folder, found = driven
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # noise: the nearest f
        return write_model(found[name], folder / name, target, nearest=True, **options)


@pytest.mark.parametrize("smooth", [pytest.param(False, marks=pytest.mark.slow), True])
@pytest.mark.parametrize("name", ["arm.urdf", "arm.xml"])
def test_the_loop_in_mujoco_is_ours_within_a_pulse(driven, tmp_path, name, smooth):
    """Motors, friction, rotors and bodies of the file alone; both joints turn, since MuJoCo's
    friction is soft at rest.

    With whole counts, each of which is a step of the torque, and without rounding, where the two
    engines nearly agree.
    """
    written = written_to(driven, name, tmp_path / "out.xml")
    rig, steps = driven[1][name].rig, 14
    rig = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=smooth))
    path = Harmonics(
        period=4.0, offset=(0.1, -0.2), cosine=np.zeros((2, 1)), sine=((0.9,), (-0.8,))
    )
    # a faster one makes more of a count that flips in one alone
    law = ComputedTorque(written.arm, rig, bandwidth=120)
    ours = simulate(written.arm, rig, law, path, duration=0.5, steps_per_sample=steps)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    model.opt.timestep, model.opt.integrator = (
        rig.period / steps,
        mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    )
    data, motion = mujoco.MjData(model), path(ours.t)
    data.qpos[:], data.qvel[:] = motion.q[0], motion.qd[0]
    running, theirs = law.start(rig, rig.counts(data.qpos.copy())), np.empty((len(ours), 2))
    for k in range(len(ours)):
        theirs[k] = data.qpos
        torque = running.step(rig.counts(theirs[k]), motion.q[k], motion.qd[k], motion.qdd[k])
        data.ctrl[:] = rig.drive.motor_torque(torque)
        mujoco.mj_step(model, data, steps)
    assert running.status == "running"
    if smooth:
        assert np.abs(rig.position_in_pulses(theirs - ours.true_q)).max() < 1e-3
    else:
        assert np.abs(rig.counts(theirs) - ours.counts).max() <= 1
        assert np.abs(rig.counts(theirs) - rig.counts(motion.q)).max() <= 1
    data.ctrl[:] = 1e3
    mujoco.mj_forward(model, data)
    limit = rig.drive.torque_limit() * np.sign(rig.drive.gear)
    np.testing.assert_allclose(data.qfrc_actuator, limit, rtol=1e-12)


def test_motors_are_added_to_a_file_that_has_none(driven, tmp_path):
    folder, found = driven
    assert (
        "<actuator>"
        not in (
            tmp_path / written_to(driven, "arm.xml", tmp_path / "a.xml", motors=False).path
        ).read_text()
    )
    own = (
        (folder / "arm.xml")
        .read_text()
        .replace("</mujoco>", '<actuator><motor joint="j0"/></actuator></mujoco>')
    )
    (folder / "own.xml").write_text(own)
    found["own.xml"] = found["arm.xml"]
    assert (
        '<actuator><motor joint="j0"/></actuator>'
        in written_to(driven, "own.xml", tmp_path / "b.xml").path.read_text()
    )
    assert written_to(driven, "own.xml", tmp_path / "c.xml").path.read_text().count("<motor ") == 1


# -- friction, included files, coupled motors ----------------------------------------------------
@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """A pendulum of two links from a file, identified from the torque equation alone."""
    folder = tmp_path_factory.mktemp("found")
    text = urdf(7, kinds=("revolute", "revolute"))
    (folder / "arm.urdf").write_text(
        text.replace("</joint>", '<dynamics friction="9"/></joint>', 1)
    )
    rig = puma560.rig()
    dynamics = Dynamics.from_chain(Chain.from_urdf(folder / "arm.urdf").with_rotors(rig.drive))
    truth = dynamics.arm(dynamics.f() * 1.03)
    path = Harmonics(
        period=2.0, offset=(0, 0), cosine=((0.4, 0.2), (0.2, -0.4)), sine=((0.1, 0.3), (-0.3, 0.1))
    )
    measured = simulate(truth, rig, P(gain=(0.5, 0.4)), path, backend="casadi")
    return folder, identify(dynamics, measured, method="equation_error", progress=False)


@pytest.mark.parametrize(
    ("curve", "lost"),
    [
        ({"rise": (0.5, 0.0)}, "drive.curve.rise"),
        ({"viscous_offset": (1e-4, 0.0)}, "drive.curve.viscous_offset"),
        ({"saturation": (20.0, 30.0)}, "drive.curve.saturation"),
        ({"saturation": (np.inf, np.inf), "rise": (0.0, 0.0)}, ""),
    ],
)
def test_friction_that_a_file_cannot_hold_is_named(identified, tmp_path, curve, lost):
    folder, found = identified
    curve = FrictionCurve(offset=(0, 0), **curve)
    drive = dataclasses.replace(found.rig.drive, curve=curve)
    curved = dataclasses.replace(found, rig=dataclasses.replace(found.rig, drive=drive))
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        write_model(curved, folder / "arm.urdf", tmp_path / "new.urdf", nearest=True)
    named = [str(line.message) for line in given if "leaves out" in str(line.message)]
    assert len(named) == bool(lost)
    assert all(lost in line for line in named)


@pytest.mark.parametrize(
    ("name", "options", "omitted"),
    [
        ("a.urdf", {}, "friction of"),
        ("a.xml", {}, "friction and motors of"),
        ("a.urdf", {"friction": False}, ""),
    ],
)
def test_what_a_file_cannot_hold_of_a_coupled_drive_is_named(
    identified, tmp_path, name, options, omitted
):
    folder, found = identified
    drive = dataclasses.replace(found.rig.drive, coupling=Coupling(matrix=((1, 0), (0.1, 1))))
    coupled = dataclasses.replace(found, rig=dataclasses.replace(found.rig, drive=drive))
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        write_model(coupled, folder / "arm.urdf", tmp_path / name, nearest=True, **options)
    lines = [str(line.message) for line in given if "coupled drive" in str(line.message)]
    assert len(lines) == bool(omitted)
    assert all(f"leaves out the {omitted}" in line for line in lines)


def test_identified_friction_is_written_joint_side(identified, tmp_path):
    folder, found = identified
    for name, friction in (("a.urdf", True), ("b.urdf", False)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # noise: the nearest f
            write_model(
                found, folder / "arm.urdf", tmp_path / name, nearest=True, friction=friction
            )
    robot = ElementTree.parse(tmp_path / "a.urdf").getroot()  # noqa: S314 - our own file
    drive = found.rig.drive
    written = [
        joint.find("dynamics") for joint in robot.iter("joint") if joint.get("type") == "revolute"
    ]
    np.testing.assert_allclose(
        [float(each.get("damping")) for each in written], drive.viscous * drive.gear**2
    )
    np.testing.assert_allclose(
        [float(each.get("friction")) for each in written], drive.coulomb * abs(drive.gear)
    )
    assert inertials_removed((tmp_path / "b.urdf").read_text()) == inertials_removed(
        (folder / "arm.urdf").read_text()
    )


@pytest.mark.slow
def test_an_mjcf_comes_back_from_pulses_with_the_robot_s_torques(tmp_path):
    """File -> log of a robot that is 10 % another -> identification -> file, whose torques are
    the robot's.
    """
    source, target, rig = tmp_path / "arm.xml", tmp_path / "found.xml", puma560.rig()
    source.write_text(mjcf(7, kinds=("hinge", "hinge")))
    chain = Chain.from_mjcf(source).with_rotors(rig.drive)
    dynamics = Dynamics.from_chain(chain)
    truth = dynamics.arm(dynamics.f() * 1.1)
    path = Harmonics(
        period=2.0, offset=(0, 0), cosine=((0.4, 0.2), (0.2, -0.4)), sine=((0.1, 0.3), (-0.3, 0.1))
    )
    measured = simulate(truth, rig, P(gain=(0.5, 0.4)), path, backend="casadi")
    found = identify(dynamics, measured, progress=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # noise: the nearest f
        write_model(found, source, target, nearest=True)
    states, names = (
        np.stack(path(np.linspace(0, 2, 101)), axis=1),
        [link.name for link in chain.links],
    )
    asked = np.array([truth.inverse(*state) for state in states])
    before, after = (
        np.abs(mujoco_torques(file, names, states) - asked).max(axis=0) for file in (source, target)
    )
    assert (after < 0.1 * before).all(), (before, after)


def test_an_inertial_in_an_included_file_is_not_written(tmp_path):
    body = (
        '<body name="b"><joint name="j"/><inertial pos="0.1 0 0" mass="1" diaginertia="1 1'
        ' 1"/></body>'
    )
    (tmp_path / "part.xml").write_text(f"<mujocoinclude>{body}</mujocoinclude>")
    (tmp_path / "main.xml").write_text(
        '<mujoco><worldbody><include file="part.xml"/></worldbody></mujoco>'
    )
    dynamics = Dynamics.from_chain(Chain.from_mjcf(tmp_path / "main.xml"), rotors=False)
    with pytest.raises(
        ValueError, match=r"inertials must stand in .*main.xml; that of b is in .*part.xml"
    ):
        write_model(dynamics.arm(1.1 * dynamics.f()), tmp_path / "main.xml", tmp_path / "new.xml")


def test_an_inertial_in_a_frame_is_not_written(tmp_path):
    """A second one would stand beside it, of which MuJoCo takes one."""
    source = tmp_path / "arm.xml"
    source.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j"/><frame pos="0 0 1">'
        '<inertial pos="0.1 0 0" mass="1" diaginertia="1 1 1"/></frame></body></worldbody></mujoco>'
    )
    dynamics = Dynamics.from_chain(Chain.from_mjcf(source), rotors=False)
    with pytest.raises(ValueError, match=r"that of b is in a <frame>"):
        write_model(dynamics.arm(dynamics.f() * 1.1), source, tmp_path / "new.xml")


def test_coupled_rotors_have_no_armature(files, tmp_path):
    chain = with_rotors(Chain.from_mjcf(files / "0.xml"), 0.2).coupled(
        Coupling(matrix=np.eye(4) + np.eye(4, k=-1))
    )
    dynamics = Dynamics.from_chain(chain)
    with pytest.raises(ValueError, match="rotors must turn with joints of their own"):
        write_model(dynamics.arm(dynamics.f()), files / "0.xml", tmp_path / "new.xml")
