"""An arm of this project as a pinocchio model (rotors left out)."""

import numpy as np
import pinocchio as pin


def frame(placement):
    """A placement as pinocchio's."""
    return pin.SE3(np.array(placement.rotation), np.array(placement.position))


def placement(link):
    """Craig's row: RotX(alpha) TransX(a) RotZ(theta + q) TransZ(d); the last two commute with
    the joint's motion.
    """
    twist = pin.SE3(pin.utils.rotate("x", link.alpha), np.array([link.a, 0.0, 0.0]))
    return (
        frame(link.before)
        * twist
        * pin.SE3(pin.utils.rotate("z", link.theta), np.array([0.0, 0.0, link.d]))
    )


def inertia_matrix(body):
    """Inertia (3, 3) about the centre of mass."""
    inertia = np.zeros((3, 3))
    inertia[np.triu_indices(3)] = body.inertia
    return inertia + np.triu(inertia, 1).T


def pinocchio_model(chain, bodies):
    """The model; positions, speeds and torques in the order of the links."""
    model, parent = pin.Model(), 0
    model.gravity.linear = np.array(chain.gravity)
    for link, body in zip(chain.links, bodies, strict=True):
        parent = model.addJoint(
            parent,
            pin.JointModelPZ() if link.prismatic else pin.JointModelRZ(),
            placement(link),
            link.name,
        )
        inertia = pin.Inertia(body.mass, np.array(body.com), inertia_matrix(body))
        model.appendBodyToJoint(parent, inertia, frame(link.frame))
    return model
