"""A model file as a tree of links and joints, and the chain that lies in it; fixed joints
lumped.
"""

import dataclasses
import graphlib
import warnings
from collections import Counter
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from plant.mechanics.body import Body
from plant.mechanics.link import Limits, Link
from plant.mechanics.placement import Placement, axis_frame, righted
from plant.mechanics.xml_file import Element
from plant.parts.arguments import choice, several
from plant.parts.fields import Floats
from plant.parts.messages import joint_labels

HERE = Placement()  # of all that state no origin

MOVING = {"revolute": False, "continuous": False, "prismatic": True}  # -> whether it slides


@dataclasses.dataclass(kw_only=True)
class ModelJoint:
    """A joint as a model file has it.

    `origin` is the pose of the child link's frame at zero, in the parent link's frame; `axis` and
    `anchor`, a point of it, are in the child link's frame; `zero` is the joint's coordinate there.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Placement
    axis: Floats
    mimics: str = ""  # name of the joint that it follows
    anchor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zero: float = 0.0
    limits: tuple[float, float, float, float] = (-np.inf, np.inf, np.inf, np.inf)
    """Lower and upper position, velocity, effort."""
    friction: tuple[float, float] = (np.nan, np.nan)
    """Viscous and Coulomb; NaN where not stated."""
    armature: float = 0.0
    element: Element | None = None


@dataclasses.dataclass(kw_only=True)
class ModelFile:
    """What a model file says: links by name with their bodies (None without mass), joints, gravity.

    `inertials` holds the element of each body, the frame of its inertia in the link's frame, and
    the element of each link; `data` the bytes of the file.
    """

    path: Path
    data: bytes
    bodies: dict[str, Body | None]
    joints: dict[str, ModelJoint]
    links: dict[str, Element]
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    def chain_joints(
        self, names: Sequence[str] | None = None, base: str | None = None, tip: str | None = None
    ) -> list[ModelJoint]:
        """The joints of the chain, base first; by default all that move, but those that mimic
        and are mimicked.
        """
        if base is not None or tip is not None:
            base = None if base is None else choice("base", base, tuple(self.bodies))
            if names is not None or tip is None:
                raise ValueError(
                    f"tip must be given with base, and no joints; got tip {tip}. Leave joints out."
                )
            names = self.joints_between(base, tip)
        _require_tree(self.bodies, self.joints)
        return _chosen(self.joints, names)

    def joints_between(self, base: str | None, tip: str) -> list[str]:
        """Names of the joints that move on their own from one link to another below it, by
        default from the root.
        """
        _require_tree(self.bodies, self.joints)
        end = {joint.child: joint for joint in self.joints.values()}.get(
            choice("tip", tip, tuple(self.bodies))
        )
        way = (
            []
            if end is None
            else _way({joint.child: joint for joint in self.joints.values()}, base, end)
        )
        if base is not None and (not way or way[0].parent != base):
            raise ValueError(
                f"tip must lie below base; {tip} does not hang on {base}. Take a link of its"
                " branch."
            )
        found = [joint.name for joint in way if joint.kind in MOVING and not joint.mimics]
        _require_own([joint for joint in way if joint.mimics in found])
        if not found:
            raise ValueError(
                f"a joint must move between base and tip {tip}; none does. Give links further"
                " apart."
            )
        return found


def links_of_chain(
    model: ModelFile, names: Sequence[str] | None
) -> tuple[tuple[Link, ...], tuple[Body, ...], Limits]:
    """Links, bodies and limits of the chain of these joints; see `Chain.from_urdf`."""
    chosen = model.chain_joints(names)
    every = model.joints
    links = []
    made = []
    rounded = dict[str, float]()
    parents = {joint.child: joint for joint in every.values()}
    hanging = _hanging_on(every)
    moving = {joint.name for joint in chosen}
    at = Placement()  # pose of the last chosen joint's frame in the link being walked
    for i, joint in enumerate(chosen):
        before = Placement()
        start = chosen[i - 1].child if i else None
        for step in _way(parents, start, joint):
            before = before if step.origin is HERE else before @ step.origin
        on_axis = Placement(rotation=axis_frame(joint.axis), position=joint.anchor)
        slides = MOVING[joint.kind]
        frame = on_axis.inverse()
        zero = {"d" if slides else "theta": -joint.zero}
        pose, rounded[joint.name] = righted(at @ before @ on_axis)
        links.append(Link(name=joint.name, prismatic=slides, before=pose, frame=frame, **zero))
        at = frame
        made.append(_lumped(model.bodies, hanging, joint.child, moving))
    if not any(body.mass for body in made):
        those = f"of links {chosen[0].child} to {chosen[-1].child} none does"
        raise ValueError(f"links must state their masses; {those}. Give them <inertial>.")
    for label, body in zip(
        joint_labels([joint.name for joint in chosen], len(chosen)), made, strict=True
    ):
        # nothing may lie between two joints whose axes meet
        if body is made[-1] or body.standard_parameters.any():
            body.require_physical(f"behind {label}")
    if most := max(rounded.values()):
        where = (
            f"that before joint {max(rounded, key=lambda name: rounded[name])} by {most:.2g} rad"
        )
        warnings.warn(
            f"{model.path.name} rounds right angles, {where}; they are put right.", stacklevel=3
        )
    made = [
        dataclasses.replace(body, rotor=joint.armature)
        for body, joint in zip(made, chosen, strict=True)
    ]
    lower, upper, velocity, effort = np.array([joint.limits for joint in chosen]).T
    return (
        tuple(links),
        tuple(made),
        Limits(lower=lower, upper=upper, velocity=velocity, effort=effort),
    )


# -- the tree ------------------------------------------------------------------------------------
def _require_tree(bodies: dict[str, Body | None], joints: dict[str, ModelJoint]) -> None:
    """Refuse missing links, links with two parents, and loops."""
    parents: dict[str, ModelJoint] = {}
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in bodies:
                choice(f"link of joint {joint.name}", link, tuple(bodies))
        if joint.child in parents:
            raise ValueError(
                f"link {joint.child} must hang on one joint; it hangs on"
                f" {parents[joint.child].name} and {joint.name}. Only trees can be read."
            )
        parents[joint.child] = joint
    try:
        graphlib.TopologicalSorter(
            {child: [joint.parent] for child, joint in parents.items()}
        ).prepare()
    except graphlib.CycleError as error:
        name = error.args[1][0]
        raise ValueError(
            f"links must form a tree; {name} hangs on itself. Remove a joint of the loop."
        ) from None


def _chosen(every: dict[str, ModelJoint], names: Sequence[str] | None) -> list[ModelJoint]:
    """The joints of the chain, from the base outwards."""
    moving = [joint for joint in every.values() if joint.kind in MOVING]
    if names is None:
        mimicked = {joint.mimics for joint in moving}
        moving = [
            joint for joint in moving if not joint.mimics and joint.name not in mimicked
        ] or moving
        chosen = _ordered(every, moving)
        if chosen is None:
            raise ValueError(
                "joints must be named where the file has a tree; it has"
                f" {several(j.name for j in moving)}. Pass tip='name of a link', and base= where it"
                " is not the file's."
            )
    else:
        if isinstance(names, str) or not names:
            raise ValueError(
                f"joints must be a list of at least one name; got {names!r}. Write ['name', ...]."
            )
        names = list(names)
        for name in names:
            if name in every and every[name].kind == "fixed":
                raise ValueError(
                    f"joints must move; {name} is fixed. Leave it out, its link is lumped."
                )
            if name not in every or every[name].kind not in MOVING:
                choice("joints", name, tuple(joint.name for joint in moving))
        twice = next((name for name, count in Counter(names).items() if count > 1), None)
        if twice is not None:
            raise ValueError(f"joints must be named once each; {twice} comes twice. Leave one out.")
        chosen = _ordered(every, [every[name] for name in names])
        if chosen is None or [joint.name for joint in chosen] != names:
            do = "Reorder." if chosen else "They are on two branches: leave out those of one."
            raise ValueError(
                f"joints must lie behind each other, base first; got {several(names)}. {do}"
            )
    if not chosen:
        raise ValueError(
            "the file must have at least one joint that moves; it has none. Give another one."
        )
    start = None if names is None else chosen[0].parent
    _require_own(_way({joint.child: joint for joint in every.values()}, start, chosen[-1]))
    return chosen


def _require_own(way: list[ModelJoint]) -> None:
    """Refuse joints between base and tip that mimic others: held at zero, they would change the
    arm.
    """
    for joint in way:
        if joint.mimics:
            how = f"{joint.name} mimics {joint.mimics}"
            raise ValueError(
                f"joints must move on their own; {how}. End the chain before it, or fix it in the"
                " file."
            )


def _ordered(every: dict[str, ModelJoint], joints: list[ModelJoint]) -> list[ModelJoint] | None:
    """These joints from the base outwards; None if they are not all on one way."""
    parents = {joint.child: joint for joint in every.values()}
    depths = dict[str, int]()
    for joint in joints:
        way = [joint]
        while way[-1].parent in parents and way[-1].name not in depths:
            way.append(parents[way[-1].parent])
        depth = depths.get(way[-1].name, 0)
        for steps, other in enumerate(reversed(way)):
            depths[other.name] = depth + steps
    ordered = sorted(joints, key=lambda joint: depths[joint.name])
    for before, joint in pairwise(ordered):
        steps = depths[joint.name] - depths[before.name]
        other = joint
        for _ in range(steps):
            other = parents[other.parent]
        if not steps or other is not before:
            return None
    return ordered


def _way(parents: dict[str, ModelJoint], start: str | None, joint: ModelJoint) -> list[ModelJoint]:
    """Joints from behind a link (None: the base) to this joint; those between are fixed, or held
    at zero.
    """
    way = [joint]
    while way[-1].parent != start and way[-1].parent in parents:
        way.append(parents[way[-1].parent])
    return way[::-1]


def fixed_to(
    every: dict[str, ModelJoint], link: str, moving: Collection[str]
) -> dict[str, Placement]:
    """Everything that moves with a link: name -> pose in its frame; joints that are none of
    `moving` are at zero.
    """
    return _moving_with(_hanging_on(every), link, moving)


def _hanging_on(every: dict[str, ModelJoint]) -> dict[str, list[ModelJoint]]:
    """The joints on each link."""
    hanging = dict[str, list[ModelJoint]]()
    for joint in every.values():
        hanging.setdefault(joint.parent, []).append(joint)
    return hanging


def _moving_with(
    hanging: dict[str, list[ModelJoint]], link: str, moving: Collection[str]
) -> dict[str, Placement]:
    found = {}
    waiting = [(link, Placement())]
    while waiting:
        name, placement = waiting.pop()
        found[name] = placement
        for joint in hanging.get(name, ()):
            if joint.name not in moving:
                waiting.append(
                    (joint.child, placement if joint.origin is HERE else placement @ joint.origin)
                )
    return found


def _lumped(
    bodies: dict[str, Body | None],
    hanging: dict[str, list[ModelJoint]],
    link: str,
    moving: Collection[str],
) -> Body:
    """Everything that moves with a link, as one Body in its frame."""
    found = None
    for name, placement in _moving_with(hanging, link, moving).items():
        if (body := bodies[name]) is not None:
            body = body.seen_from(placement)
            found = body if found is None else found.joined(body)
    return found or Body(mass=0.0, com=np.zeros(3))
