"""Batches of rotations: unit quaternions (w, x, y, z), shape (..., 4), and rotation vectors."""

import numpy as np

from ..assets.fields import Array


def multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton product a b: first b, then a. Shapes (..., 4)."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: Array) -> Array:
    """Return the inverse rotation. Shape (..., 4)."""
    return np.concatenate([q[..., :1], -q[..., 1:]], axis=-1)


def exp(rotation_vector: Array) -> Array:
    """Return the quaternion of a rotation about the vector by its length, (..., 3) -> (..., 4)."""
    angle = np.linalg.norm(rotation_vector, axis=-1, keepdims=True)
    # np.sinc(x) is sin(pi x) / (pi x), and 1 at 0.
    vector = 0.5 * np.sinc(angle / (2.0 * np.pi)) * rotation_vector
    return np.concatenate([np.cos(0.5 * angle), vector], axis=-1)


def log(q: Array) -> Array:
    """Return the shortest rotation vector [rad]. Shapes (..., 4) -> (..., 3)."""
    shortest = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(shortest[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, shortest[..., :1])
    # If the sine is 0, so is the vector; any finite factor will do, and 2 is the limit.
    factor = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    return np.asarray(factor * shortest[..., 1:])


def angle_deg(one: Array, other: Array) -> Array:
    """Return the angle between orientations (n, 4), (n,) [deg]."""
    return np.asarray(np.degrees(np.linalg.norm(log(multiply(one, conjugate(other))), axis=1)))


def about_z(angle: float) -> Array:
    """Return the quaternion of a rotation about z [rad]. Shape (4,)."""
    return np.array([np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)])


def same_sign_chain(q: Array) -> Array:
    """Choose each quaternion's sign so that it is nearest to the one before. Shape (n, 4)."""
    flips = np.einsum("ij,ij->i", q[1:], q[:-1]) < 0.0
    signs = np.where(np.concatenate([[False], np.cumsum(flips) % 2 == 1]), -1.0, 1.0)
    return q * signs[:, None]


def rotate(q: Array, v: Array) -> Array:
    """Rotate vectors v (n, 3) by unit quaternions q (n, 4), (w, x, y, z)."""
    w, u = q[:, :1], q[:, 1:]
    across = 2.0 * np.cross(u, v)
    return np.asarray(v + w * across + np.cross(u, across))
