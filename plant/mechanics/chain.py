"""A serial chain: geometry as Denavit-Hartenberg rows or poses, gravity, and the links' bodies."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.mechanics.body import Body
from plant.mechanics.coupling import Coupling
from plant.mechanics.link import Limits, Link, near_each_other
from plant.mechanics.mjcf_file import read_mjcf
from plant.mechanics.model_tree import links_of_chain
from plant.mechanics.placement import Placement
from plant.mechanics.urdf_file import read_urdf
from plant.parts import (
    JointUnits,
    Nested,
    Part,
    array,
    choice,
    instance,
    joint_labels,
    part,
    real,
    structure,
)

_KEYS = ("alpha", "a", "d", "theta", "prismatic", "name")


@part
class Chain(Part):
    """Serial chain of revolute and prismatic joints.

    Parameters
    ----------
    links : tuple of Link
        From the base outwards.
    gravity : (3,) array_like
        Acceleration of gravity in the base frame [m/s^2]; of a tilted base see `tilted`.
    bodies : tuple of Body, optional
        Inertial parameters of the links, if known, each in the ``frame`` of its link.
    coupling : Coupling, optional
        Coupling of motors that move several joints: `Body.rotor` is then reflected to the shaft.
    limits : Limits, optional
        Limits of positions, speeds and efforts, as a model file states them.

    See Also
    --------
    plant.Link, plant.Body, plant.Dynamics, plant.Lumping

    Examples
    --------
    >>> from plant import Chain, Link, Lumping, Dynamics
    >>> links = Link(name="shoulder"), Link(name="elbow", a=0.4)
    >>> chain = Chain(links=links, gravity=(0, -9.81, 0))
    >>> dynamics = Dynamics.from_chain(chain)
    >>> dynamics.n, dynamics.names[3:5]
    (2, ('mx_elbow', 'my_elbow'))
    """

    links: tuple[Link, ...] = structure()
    gravity: Nested = structure(default=(0.0, 0.0, -9.81))
    bodies: tuple[Body, ...] = structure(default=())
    coupling: Coupling = structure(Coupling, default=Coupling())
    limits: Limits | None = structure(Limits, default=None)

    def __post_init__(self) -> None:
        # A chain of one link may be given by the link itself.
        links = _several(self.links)
        if not links or not all(isinstance(link, Link) for link in links):
            raise ValueError(
                f"links must be at least one Link; got {self.links!r:.80}. Give a tuple of"
                " Link(...)."
            )
        # The names of links become those of joints and parameters, so each may occur once.
        names = [link.name for link in links]
        twice = [name for i, name in enumerate(names) if name in names[:i]]
        if twice:
            raise ValueError(
                f"links must have names of their own; {twice[0]!r} comes twice. Rename one."
            )
        gravity = array("gravity", self.gravity, (3,), advice="Give m/s^2, such as (0, 0, -9.81).")
        # Bodies are optional, since equations need only the geometry; if any is given, all must be.
        bodies = _several(self.bodies)
        others = [type(body).__name__ for body in bodies if not isinstance(body, Body)]
        if bodies and (others or len(bodies) != len(links)):
            # Of the right number, one is no body.
            got = f"one of type {others[0]}" if len(bodies) == len(links) else len(bodies)
            raise ValueError(
                f"bodies must be {len(links)}, one Body per link; got {got}. Add or leave out."
            )
        # A coupling for other joints would be broadcast without a word.
        self.coupling.require_size(len(links), "chain")
        if self.limits is not None and self.limits.n != len(links):
            raise ValueError(
                f"limits must have {len(links)} joints; got {self.limits.n}. Give one number per"
                " joint."
            )
        # A frozen part keeps plain tuples, so that equal chains are equal and hash alike.
        object.__setattr__(self, "links", near_each_other(links))
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))
        object.__setattr__(self, "bodies", bodies)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def joint_labels(self) -> list[str]:
        """Labels of the joints, by their links' names (`joint_label`)."""
        return joint_labels([link.name for link in self.links], self.n)

    @property
    def joint_units(self) -> list[JointUnits]:
        """Units of the joints: those of slides are m and N."""
        return [link.units for link in self.links]

    @property
    def effort_units(self) -> list[str]:
        """Units of the joints' torques: N of a slide."""
        return [unit.effort for unit in self.joint_units]

    def tilted(self, rotation: ArrayLike) -> Chain:
        """The same chain on a tilted base.

        The columns of the rotation (3, 3) are the tilted base's axes in the present base frame.
        """
        placement = Placement(rotation=rotation)
        # R^T turns gravity from the present base frame into that of the tilted base.
        gravity = np.array(placement.rotation).T @ np.array(self.gravity)
        return dataclasses.replace(self, gravity=gravity)

    def coupled(self, coupling: Coupling) -> Chain:
        """The same chain with this coupling, such as that of its `Drive`."""
        return dataclasses.replace(self, coupling=coupling)

    def with_rotors(self, drive: Any) -> Chain:
        """The same chain with the rotor inertias and the coupling of a `Drive`."""
        if not self.bodies:
            raise ValueError(
                "bodies must be known to get rotors; this chain has none. Give the Chain its"
                " bodies."
            )
        # Checked here, since `zip` below would refuse another size without a helpful message.
        if drive.n != self.n:
            raise ValueError(
                f"drive must have {self.n} joints like the chain; got {drive.n}. Use a matching"
                " drive."
            )
        # A rotor counts with Jm k^2 on its shaft; the coupling carries it on to the joints.
        pairs = zip(self.bodies, drive.reflected_inertia(), strict=True)
        bodies = tuple(dataclasses.replace(body, rotor=float(rotor)) for body, rotor in pairs)
        return dataclasses.replace(self, bodies=bodies, coupling=drive.coupling)

    def carrying(self, body: Body, link: int | str = -1) -> Chain:
        """The same chain with a tool or a load fixed to a link, the last one by default.

        The body is given in the frame of the link's own body. The link is given by its index from
        0 or by its name.
        """
        # The two bodies are joined, since the equations of motion contain only their sum.
        instance("body", body, Body, "Give mass and com; a point mass needs no inertia.")
        if not self.bodies:
            raise ValueError(
                "bodies must be known to carry one more; this chain has none. Give the Chain its"
                " bodies."
            )
        # A link may be given by its name, since its index changes when a model file grows.
        names = [carrier.name for carrier in self.links]
        if isinstance(link, str):
            link = names.index(choice("link", link, names))
        # A negative index counts from the tip, as in Python; True is an int, but no index.
        whole = isinstance(link, (int, np.integer)) and not isinstance(link, bool)
        if not whole or not -self.n <= link < self.n:
            raise ValueError(
                f"link must be a name or a place from {-self.n} to {self.n - 1}; got {link!r}."
                f" Names: {', '.join(names)}."
            )
        bodies = list(self.bodies)
        bodies[link] = bodies[link].joined(body)
        return dataclasses.replace(self, bodies=tuple(bodies))

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        joints: Sequence[str] | None = None,
        *,
        base: str | None = None,
        tip: str | None = None,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
    ) -> Chain:
        """A chain, with bodies, from a URDF file.

        Parameters
        ----------
        path : str or Path
        joints : sequence of str, optional
            Names of the chain's joints, base first; by default all that move, if they form one
            chain. Other joints that move are held at zero, like fixed joints, and what they move
            is lumped with the link that carries them. Joints that mimic another joint, and the
            joints that they mimic (those of a gripper), are also held unless they are named. Inside
            the chain, a joint that mimics is refused, and one that is mimicked belongs to it.
        base, tip : str, optional
            Names of two links, in place of `joints`: the chain has the joints between these links.
            The default `base` is the base link of the file.
        gravity : (3,) array_like
            In the frame of the file's base link.

        Returns
        -------
        Chain
            Bodies in the frames of the file's links, with `limits`; meshes and transmissions are
            not read. Friction and efforts make a `Drive`: `Drive.from_urdf`.

        Raises
        ------
        ValueError
            A file that is malformed, too large, or describes no such chain; a body that is not
            physically consistent.

        Warns
        -----
        UserWarning
            Angles within 1e-3 rad of right ones are put right: files round them, and axes that are
            nearly parallel or perpendicular have base parameters that no log excites. Joints beside
            the chain that mimic one of its joints are held.
        """
        # base and tip are first turned into joints: below, a chain is a list of joints.
        model = read_urdf(path)
        names = [joint.name for joint in model.chain_joints(joints, base, tip)]
        links, bodies, limits = links_of_chain(model, names)
        return cls(links=links, gravity=gravity, bodies=bodies, limits=limits)

    @classmethod
    def from_mjcf(
        cls,
        path: str | Path,
        joints: Sequence[str] | None = None,
        *,
        base: str | None = None,
        tip: str | None = None,
    ) -> Chain:
        """A chain, with bodies, from a MuJoCo model of hinges and slides.

        The parameters are those of `from_urdf`; joints that are not chosen are held at their
        ``ref``. The file gives the gravity, the rotors (``armature``) and the `limits` (``range``,
        ``actuatorfrcrange``, ``forcerange`` of the actuators, and ``ctrlrange`` of those whose
        force is the control times a gain). Damping and frictionloss are not read: they belong to
        the `Drive`. A file may have anything beside the chain. This method refuses springs, tendons
        and equalities that act on the chain's joints or between its bodies, free and ball joints
        within the chain, fluids, and bodies of the chain whose mass comes from geoms. It ignores
        ``gravcomp``, which belongs to a controller, and warns that the bodies keep their weight.
        """
        model = read_mjcf(path)
        names = [joint.name for joint in model.chain_joints(joints, base, tip)]
        # Unlike URDF, the file states gravity.
        links, bodies, limits = links_of_chain(model, names)
        return cls(links=links, gravity=model.gravity, bodies=bodies, limits=limits)

    @classmethod
    def standard(
        cls,
        rows: Sequence[Mapping[str, Any]],
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        bodies: Sequence[Body] = (),
    ) -> Chain:
        """A chain from rows of the *standard* Denavit-Hartenberg table.

        Parameters
        ----------
        rows : sequence of dict
            One row per joint, with alpha, a, d, and optionally theta, prismatic and name. The frame
            i is RotZ(theta + q) TransZ(d) TransX(a) RotX(alpha) in the frame i - 1; a prismatic
            joint adds q to d, not to theta.
        gravity : (3,) array_like
        bodies : tuple of Body, optional
            Given in the frames of the standard table, which sit at the far end of their links.
        """
        # The standard table has alpha_i and a_i at the far end of link i, the modified one at its
        # near end. So each Link begins with the twist and length of the previous row, and the frame
        # of its body lies at the far end.
        links: list[Link] = []
        start: dict[str, Any] = {"alpha": 0.0, "a": 0.0}
        for i, row in enumerate(rows):
            advice = "Give alpha, a and d by name; rows of the modified table are Links."
            instance(f"row {i}", row, dict, advice)
            label = f"a key of row {i} (standard table; rows of the modified one are Links)"
            # A misspelt key would silently take its default.
            for key in row:
                choice(label, key, _KEYS)
            for key in ("alpha", "a", "d"):
                if key not in row:
                    raise ValueError(f"row {i} must have {key}; it has {', '.join(row)}. Add it.")
                real(f"{key} of row {i}", row[key], "Give it in SI units.")
            end = {"alpha": row["alpha"], "a": row["a"]}
            fields = {"name": str(i + 1)} | dict(row) | start
            links.append(Link(**fields, frame=Placement.of_row(**end)))
            start = end
        return cls(links=tuple(links), gravity=gravity, bodies=_several(bodies))


def _several(given: Any) -> tuple[Any, ...]:
    """The items of a sequence; a single link or body stands for a sequence of one."""
    return tuple(given) if np.iterable(given) else (given,)
