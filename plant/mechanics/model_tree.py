"""A model file as a tree of links and joints, and the serial chain in it; fixed joints lumped."""

import dataclasses
import graphlib
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from plant.mechanics.body import Body
from plant.mechanics.link import Limits, Link
from plant.mechanics.placement import Placement, axis_frame, righted
from plant.mechanics.xml_file import Element
from plant.parts import Floats, choice, joint_labels, near, several

T = TypeVar("T")

HERE = Placement()  # of all that state no origin

MOVING = {"revolute": False, "continuous": False, "prismatic": True}  # -> whether it slides


@dataclasses.dataclass(kw_only=True)
class ModelJoint:
    """A joint of a model file.

    `origin` is the pose of the child link's frame in the parent link's frame where the joint's
    coordinate is `zero`. `axis` and `anchor`, a point of the axis, are in the child link's frame.
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
    immovable: str = ""
    """Why a chain cannot have this joint; empty if it can."""
    misplaced: str = ""
    """Why the pose of its child cannot be read; empty if it can."""


@dataclasses.dataclass(kw_only=True)
class Constraint:
    """A force or constraint between links or joints; a chain on which it acts is refused.

    `label` names it in messages. One that names neither joints nor links acts on every chain.
    """

    label: str
    joints: list[str]
    links: list[str]


def deferred(default: T, read: Callable[..., T], *arguments: Any) -> tuple[T, str]:
    """The result of `read` and "", or the default and the message of the ValueError.

    The message is for a chain that needs what was not read.
    """
    try:
        return read(*arguments), ""
    except ValueError as error:
        return default, str(error)


# Not frozen: a reader fills it body by body.
@dataclasses.dataclass(kw_only=True)
class ModelFile:
    """Content of a model file: links with their bodies (None without mass), joints, gravity.

    `links` holds the element of each link, `data` the bytes of the file. A file may have much that
    a chain does not need: `unread` holds why the body of a link cannot be read, `unread_branches`
    why parts that may have joints cannot, `constraints` what acts beside the joints,
    `gravity_compensated` the links whose weight the file takes away.
    """

    path: Path
    data: bytes
    bodies: dict[str, Body | None]
    joints: dict[str, ModelJoint]
    links: dict[str, Element]
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    unread: dict[str, str] = dataclasses.field(default_factory=dict)
    unread_branches: list[str] = dataclasses.field(default_factory=list)
    constraints: list[Constraint] = dataclasses.field(default_factory=list)
    gravity_compensated: list[str] = dataclasses.field(default_factory=list)

    def chain_joints(
        self, names: Sequence[str] | None = None, base: str | None = None, tip: str | None = None
    ) -> list[ModelJoint]:
        """The joints of the chain, base first.

        By default all that move, without those of a gripper, which mimic another joint or are
        mimicked. A mimicked joint that carries another joint of the chain is no gripper's, and a
        file in which all joints mimic or are mimicked has no gripper.
        """
        # Names may come as a column of a table, which has no truth value.
        if isinstance(names, np.ndarray):
            names = names.tolist()
        self._require_read(names, base, tip)
        # base and tip name the joints between them, so a list of joints would contradict them.
        if base is not None or tip is not None:
            base = None if base is None else choice("base", base, tuple(self.bodies))
            if names is not None or tip is None:
                advice = "Give tip='name of a link'." if names is None else "Leave joints out."
                raise ValueError(
                    f"tip must be given with base, and no joints; got tip {tip} and joints {names}."
                    f" {advice}"
                )
            names = self.joints_between(base, tip)
        # A loop would let the walks below run for ever.
        _require_tree(self.joints)
        return _chosen(self.joints, names)

    def _require_read(self, names: Sequence[str] | None, base: str | None, tip: str | None) -> None:
        """Refuse a chain that may lie in a part of the file that was not read.

        A chain whose joints or ends are all in the rest of the file lies there.
        """
        if not self.unread_branches:
            return
        stated = names is not None or tip is not None
        present = set(names or ()) <= self.joints.keys()
        present &= {base, tip} - {None} <= self.bodies.keys()
        if not stated or not present:
            raise ValueError(self.unread_branches[0])

    def joints_between(self, base: str | None, tip: str) -> list[str]:
        """Names of the independent joints from a base link (default: the root) to a tip link."""
        _require_tree(self.joints)
        parents = _parents(self.joints)
        end = parents.get(choice("tip", tip, tuple(self.bodies)))
        path = [] if end is None else _path(parents, base, end)
        if base is not None and (not path or path[0].parent != base):
            raise ValueError(
                f"tip must lie below base; {tip} does not hang on {base}. Take a link of its"
                " branch."
            )
        names = [joint.name for joint in path if joint.kind in MOVING and not joint.mimics]
        # Neither may count as fixed: a joint that follows one of `names` moves with it, and a chain
        # cannot have an immovable joint.
        _require_own([joint for joint in path if joint.mimics in names or joint.immovable])
        if not names:
            raise ValueError(
                f"a joint must move between base and tip {tip}; none does. Give links further"
                " apart."
            )
        return names


def links_of_chain(
    model: ModelFile, names: Sequence[str] | None
) -> tuple[tuple[Link, ...], tuple[Body, ...], Limits]:
    """Links, bodies and limits of the chain of these joints; see `Chain.from_urdf`."""
    chosen = model.chain_joints(names)
    links = []
    bodies = []
    rounded = dict[str, float]()
    # For every link the joint that carries it, and the joints that it carries.
    parents = _parents(model.joints)
    hanging = _hanging_on(model.joints)
    moving = {joint.name for joint in chosen}
    _require_free(model, hanging, chosen)
    at = Placement()  # pose of the file's last chosen link in the frame of its Link
    # 1. Walk from joint to joint. Fixed joints and joints at zero between them multiply into one
    # pose.
    for i, joint in enumerate(chosen):
        pose = Placement()
        start = chosen[i - 1].child if i else None
        for step in _path(parents, start, joint):
            if step.misplaced:
                raise ValueError(step.misplaced)
            pose = pose if step.origin is HERE else pose @ step.origin
        # 2. Put the frame of the Link on the joint's axis, z along it, as the table demands; the
        # body stays in the frame of the file's link, which `frame` places in it.
        on_axis = Placement(rotation=axis_frame(joint.axis), position=joint.anchor)
        slides = MOVING[joint.kind]
        frame = on_axis.inverse()
        # The file states its frames at the coordinate joint.zero: the offset subtracts it from q.
        zero = {"d" if slides else "theta": -joint.zero}
        pose, rounded[joint.name] = righted(at @ pose @ on_axis)
        links.append(Link(name=joint.name, prismatic=slides, before=pose, frame=frame, **zero))
        at = frame
        # 3. Everything that hangs on the link without a chosen joint between becomes its body.
        bodies.append(_lumped(model, hanging, joint.child, moving))
    if not any(body.mass for body in bodies):
        raise ValueError(
            f"links must state their masses; of links {chosen[0].child} to {chosen[-1].child} none"
            " does. Give them <inertial>."
        )
    labels = joint_labels([joint.name for joint in chosen], len(chosen))
    for label, body in zip(labels, bodies, strict=True):
        # Two joints whose axes meet may have no body between them, but the tip has one.
        if body is bodies[-1] or body.standard_parameters.any():
            body.require_physical(f"behind {label}", SLIP)
    worst = max(rounded, key=lambda name: rounded[name])
    if rounded[worst]:
        warnings.warn(
            f"{model.path.name} rounds right angles, that before joint {worst} by"
            f" {rounded[worst]:.2g} rad; they are put right.",
            stacklevel=3,
        )
    _warn_of_slips(model, hanging, chosen)
    _warn_of_mimics(model, hanging, moving)
    # Rotors come last: the armature of a joint that is held at zero does not count.
    pairs = zip(bodies, chosen, strict=True)
    bodies = [dataclasses.replace(body, rotor=joint.armature) for body, joint in pairs]
    lower, upper, velocity, effort = np.array([joint.limits for joint in chosen]).T
    limits = Limits(lower=lower, upper=upper, velocity=velocity, effort=effort)
    return tuple(links), tuple(bodies), limits


# Files round their inertias, and people adjust them: a largest moment that exceeds the sum of the
# others by less than this share is a slip (of 3 % in a public file), more is another mistake.
SLIP = 0.1


def _warn_of_slips(
    model: ModelFile, hanging: dict[str, list[ModelJoint]], chosen: list[ModelJoint]
) -> None:
    """Warn of inertias that miss the triangle inequality, and of weight that a file takes away."""
    moving = {joint.name for joint in chosen}
    links = [link for joint in chosen for link in _moving_with(hanging, joint.child, moving)]
    for link in links:
        body = model.bodies[link]
        excess = 0.0 if body is None else body.excess()
        # Below this, numbers of six digits are rounded.
        if excess > 1e-5:
            warnings.warn(
                f"{model.path.name} states an inertia of link {link} that misses the triangle"
                f" inequality by {100 * excess:.2g} %; it is read as it stands. check_model names"
                " what is wrong with a URDF.",
                stacklevel=4,
            )
    weightless = [link for link in links if link in model.gravity_compensated]
    if weightless:
        warnings.warn(
            f"{model.path.name} compensates the gravity of {several(weightless)} (gravcomp), which"
            " is a controller's; the arm has its weight. Motor torques logged in MuJoCo lack it.",
            stacklevel=4,
        )


def _warn_of_mimics(
    model: ModelFile, hanging: dict[str, list[ModelJoint]], moving: Collection[str]
) -> None:
    """Warn of joints with masses behind them that mimic joints of the chain, but are held."""
    mimicking = []
    for joint in model.joints.values():
        if joint.kind in MOVING and joint.mimics in moving:
            bodies = [model.bodies.get(link) for link in _moving_with(hanging, joint.child, moving)]
            # What is drawn only needs no torque.
            if any(body is not None and body.mass for body in bodies):
                mimicking.append(f"{joint.name} ({joint.mimics})")
    if mimicking:
        warnings.warn(
            f"{model.path.name} has joints that mimic joints of the chain: {several(mimicking)};"
            " they are held at zero. Torques lack the motion of their links.",
            stacklevel=4,
        )


def _require_free(
    model: ModelFile, hanging: dict[str, list[ModelJoint]], chosen: list[ModelJoint]
) -> None:
    """Refuse forces and constraints that act on the joints of the chain, or between its bodies."""
    moving = {joint.name for joint in chosen}
    # The number of the joint with which each link moves; all others stand still, or are elsewhere.
    carriers = {
        link: i
        for i, joint in enumerate(chosen)
        for link in _moving_with(hanging, joint.child, moving)
    }
    for constraint in model.constraints:
        joints = moving.intersection(constraint.joints)
        ends = {carriers.get(link, -1) for link in constraint.links}
        unnamed = not constraint.joints and not constraint.links
        # Between parts of one body a force is inner, as that of a gripper's fingers.
        if joints or len(ends) > 1 or unnamed:
            at = several(sorted(joints) or sorted(set(constraint.links)) or ["what it leaves open"])
            raise ValueError(
                f"{constraint.label} must not act on the chain, since its force is not read; it"
                f" acts on {at}. Remove it, or choose joints on which it does not act."
            )


# -- the tree ------------------------------------------------------------------------------------
def _require_tree(joints: dict[str, ModelJoint]) -> None:
    """Refuse links with two parents, and loops."""
    parents: dict[str, ModelJoint] = {}
    for joint in joints.values():
        if joint.child in parents:
            raise ValueError(
                f"link {joint.child} must hang on one joint; it hangs on"
                f" {parents[joint.child].name} and {joint.name}. Only trees can be read."
            )
        parents[joint.child] = joint
    # The sorter finds loops; its order is of no interest.
    try:
        graph = {child: [joint.parent] for child, joint in parents.items()}
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        name = error.args[1][0]
        raise ValueError(
            f"links must form a tree; {name} hangs on itself. Remove a joint of the loop."
        ) from None


def _parents(joints: dict[str, ModelJoint]) -> dict[str, ModelJoint]:
    """The joint on which each link hangs, by the name of the link."""
    return {joint.child: joint for joint in joints.values()}


def _chosen(tree: dict[str, ModelJoint], names: Sequence[str] | None) -> list[ModelJoint]:
    """The joints of the chain, from the base outwards."""
    moving = [joint for joint in tree.values() if joint.kind in MOVING]
    if names is None:
        # A misspelt type ends the chain too early, and nobody named the joints that are meant.
        misspelt = [joint for joint in tree.values() if near(joint.kind, MOVING, cutoff=0.8)]
        _require_own([joint for joint in misspelt if joint.immovable])
        # A gripper's fingers mimic each other: without them most files hold one chain.
        mimicked = {joint.mimics for joint in moving}
        moving = [
            joint for joint in moving if not joint.mimics and joint.name not in mimicked
        ] or moving
        # Several branches: the file does not say which one is meant.
        chosen = _ordered(tree, moving)
        if chosen is None:
            _require_placed(moving)
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
        # Three mistakes, three messages: a fixed joint, an unknown name, a name that comes twice.
        for name in names:
            if name in tree and tree[name].kind == "fixed":
                raise ValueError(
                    f"joints must move; {name} is fixed. Leave it out, its link is lumped."
                )
            if name in tree and tree[name].immovable:
                raise ValueError(tree[name].immovable)
            if name not in tree or tree[name].kind not in MOVING:
                choice("joints", name, tuple(joint.name for joint in moving))
        twice = next((name for name, count in Counter(names).items() if count > 1), None)
        if twice is not None:
            raise ValueError(f"joints must be named once each; {twice} comes twice. Leave one out.")
        # The order of the names has to be that of the tree: the order of q would otherwise be a
        # surprise.
        moving = [tree[name] for name in names]
        chosen = _ordered(tree, moving)
        if chosen is None or [joint.name for joint in chosen] != names:
            _require_placed(moving)
            do = "Reorder." if chosen else "They are on two branches: leave out those of one."
            raise ValueError(
                f"joints must lie behind each other, base first; got {several(names)}. {do}"
            )
    if not chosen:
        # A joint that no chain can have may be the one that is meant.
        _require_own([joint for joint in tree.values() if joint.immovable])
        raise ValueError(
            "the file must have at least one joint that moves; it has none. Give another one."
        )
    # From the base of the file on, or from the first named joint on.
    start = None if names is None else chosen[0].parent
    path = _path(_parents(tree), start, chosen[-1])
    _require_own(path)
    # A mimicked joint before the last one is the arm's: a rod beside the arm may follow it.
    return chosen if names is not None else [joint for joint in path if joint.kind in MOVING]


def _require_placed(joints: list[ModelJoint]) -> None:
    """Refuse a joint whose child has no readable pose, with the reason."""
    for joint in joints:
        if joint.misplaced:
            raise ValueError(joint.misplaced)


def _require_own(path: list[ModelJoint]) -> None:
    """Refuse immovable joints, and those that mimic others: to hold these would change the arm."""
    for joint in path:
        if joint.immovable:
            raise ValueError(joint.immovable)
        if joint.mimics:
            raise ValueError(
                f"joints must move on their own; {joint.name} mimics {joint.mimics}. End the chain"
                " before it, or fix it in the file."
            )


def _ordered(tree: dict[str, ModelJoint], joints: list[ModelJoint]) -> list[ModelJoint] | None:
    """These joints from the base outwards; None if they do not lie on one path."""
    # 1. Find the depth of each joint. A walk stops at the first joint of known depth, so that no
    # part of the tree is climbed twice.
    parents = _parents(tree)
    depths = dict[str, int]()
    for joint in joints:
        path = [joint]
        while path[-1].parent in parents and path[-1].name not in depths:
            path.append(parents[path[-1].parent])
        depth = depths.get(path[-1].name, 0)
        for steps, ancestor in enumerate(reversed(path)):
            depths[ancestor.name] = depth + steps
    # 2. In the order of depth each joint must be an ancestor of the next one: two at one depth, or
    # on two branches, form no chain.
    ordered = sorted(joints, key=lambda joint: depths[joint.name])
    for previous, joint in pairwise(ordered):
        steps = depths[joint.name] - depths[previous.name]
        ancestor = joint
        for _ in range(steps):
            ancestor = parents[ancestor.parent]
        if not steps or ancestor is not previous:
            return None
    return ordered


def _path(parents: dict[str, ModelJoint], start: str | None, joint: ModelJoint) -> list[ModelJoint]:
    """Joints on the path from a link (None: the base) to this joint, outwards."""
    path = [joint]
    # From the joint up to the start; reversed below, the path leads outwards.
    while path[-1].parent != start and path[-1].parent in parents:
        path.append(parents[path[-1].parent])
    return path[::-1]


def fixed_to(
    tree: dict[str, ModelJoint], link: str, moving: Collection[str]
) -> dict[str, Placement]:
    """Poses of all links that move with this one, by name, in its frame.

    Each joint that is not in `moving` stays at its `zero`.
    """
    return _moving_with(_hanging_on(tree), link, moving)


def _hanging_on(tree: dict[str, ModelJoint]) -> dict[str, list[ModelJoint]]:
    """The joints on each link."""
    hanging = dict[str, list[ModelJoint]]()
    for joint in tree.values():
        hanging.setdefault(joint.parent, []).append(joint)
    return hanging


def _moving_with(
    hanging: dict[str, list[ModelJoint]], link: str, moving: Collection[str]
) -> dict[str, Placement]:
    poses = {}
    # Depth-first, with a stack instead of a recursion: a tree may be deep.
    waiting = [(link, Placement())]
    while waiting:
        name, placement = waiting.pop()
        poses[name] = placement
        for joint in hanging.get(name, ()):
            # A chosen joint begins the next body of the chain.
            if joint.name not in moving:
                pose = placement if joint.origin is HERE else placement @ joint.origin
                waiting.append((joint.child, pose))
    return poses


def _lumped(
    model: ModelFile,
    hanging: dict[str, list[ModelJoint]],
    link: str,
    moving: Collection[str],
) -> Body:
    """All bodies that move with a link as one Body in its frame."""
    lumped = None
    parents = _parents(model.joints)
    for name, placement in _moving_with(hanging, link, moving).items():
        # What cannot be read matters here, where its mass moves.
        reason = model.unread.get(name, "") or (name != link and parents[name].misplaced)
        if reason:
            raise ValueError(reason)
        # Each body is given in the frame of its own link.
        body = model.bodies[name]
        if body is not None:
            body = body.seen_from(placement)
            lumped = body if lumped is None else lumped.joined(body)
    return lumped or Body(mass=0.0, com=np.zeros(3))
