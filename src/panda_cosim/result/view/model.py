"""Describes a MuJoCo model for the page: bodies, joints, shapes, meshes, textures, cameras."""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError, one_line
from ...task.files import MODEL_FILE
from .columns import Json, pack

GROUPS: Final = 3  # the groups that MuJoCo's own viewer shows: 0, 1, 2
TEXTURE_SIDE: Final = 128  # [px] largest texture; larger ones are scaled down
RGB: Final = 3  # channels
SHAPES: Final = ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
MESHES: Final = {"hfield": "mesh", "sdf": "mesh"}  # drawn as such
_PLAIN = (0.5, 0.5, 0.5, 1.0)  # a geom's default colour


def describe(model: Any) -> Json:
    """Return a model as plain values for the page.

    It has geoms and sites of groups 0 to 2 that are not fully transparent. Height fields become
    meshes; textures other than plane images become their mean colour.
    """
    shapes = _Shapes(model)
    try:
        bodies = [_body(model, body, shapes) for body in range(model.nbody)]
    except (IndexError, KeyError, ValueError, OverflowError) as error:  # a damaged one
        raise InputError(f"{MODEL_FILE}: cannot be drawn: {one_line(error)}") from error
    return {
        "nq": int(model.nq),
        "qpos0": _floats(model.qpos0, 9),
        "gravity": _floats(model.opt.gravity),
        "bodies": bodies,
        "meshes": [*shapes.meshes.values()],
        "textures": [*shapes.textures.values()],
        "cameras": [_camera(model.cam(index)) for index in range(model.ncam)],
        "center": _floats(model.stat.center),
        "extent": float(model.stat.extent),
    }


def _word(kind: Any) -> str:
    """Return the word of MJCF for a type of MuJoCo: "box" for mjGEOM_BOX."""
    return str(kind.name).rpartition("_")[2].lower()


def _floats(values: Any, digits: int = 5) -> list[float]:
    return [round(float(value), digits) for value in np.ravel(values)]


def _body(model: Any, index: int, shapes: _Shapes) -> Json:
    body = model.body(index)
    geoms = map(model.geom, np.flatnonzero(model.geom_bodyid == index).tolist())
    sites = map(model.site, np.flatnonzero(model.site_bodyid == index).tolist())
    joints = map(model.joint, np.flatnonzero(model.jnt_bodyid == index).tolist())
    drawn = map(shapes.shape, (*geoms, *sites))
    return {
        "name": body.name,
        "parent": body.parentid.item(),
        "fixed": body.weldid.item() == 0,
        "pos": _floats(body.pos, 9),
        "quat": _floats(body.quat, 9),
        "com": _floats(body.ipos, 9),
        "mass": body.mass.item(),
        "joints": [*map(_joint, joints)],
        "shapes": [shape for shape in drawn if shape is not None],
    }


def _joint(joint: Any) -> Json:
    return {
        "name": joint.name,
        "kind": _word(mujoco.mjtJoint(joint.type.item())),
        "address": joint.qposadr.item(),
        "axis": _floats(joint.axis, 9),
        "pos": _floats(joint.pos, 9),
        "zero": float(joint.qpos0[0]),
        "range": _floats(joint.range if joint.limited.item() else (), 6),
    }


def _camera(camera: Any) -> Json:
    """Return a camera in the frame of its body; quaternion (w, x, y, z), it looks along -z."""
    return {
        "name": camera.name or f"camera {camera.id + 1}",
        "body": camera.bodyid.item(),
        "pos": _floats(camera.pos),
        "quat": _floats(camera.quat, 7),
        "fovy": camera.fovy.item(),
    }


class _Shapes:
    """Geoms and sites; each mesh and texture they use is kept once."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self.meshes: dict[tuple[bool, int], Json] = {}  # by whether it is a field, and index
        self.textures: dict[int, Json] = {}

    def shape(self, drawn: Any) -> Json | None:
        """Return a geom or site, or None if it is not shown."""
        own = _word(mujoco.mjtGeom(drawn.type.item()))
        kind = MESHES.get(own, own)
        look, rgba = self._look(drawn.matid.item(), drawn.rgba)
        if kind not in SHAPES or drawn.group.item() >= GROUPS or rgba[3] == 0.0:
            return None
        frame = {"pos": _floats(drawn.pos), "quat": _floats(drawn.quat, 7)}
        shape = {"kind": kind, "size": _floats(drawn.size), **frame, "rgba": rgba, **look}
        if kind == "mesh":
            shape["mesh"] = self._mesh((own == "hfield", drawn.dataid.item()))
        return shape

    def _look(self, index: int, own: Any) -> tuple[Json, list[float]]:
        """Return gloss and texture, and the colour; its own overrides the material's."""
        if index < 0:
            return {}, _floats(own, 4)
        m = self._model
        material = m.mat(index)
        chosen = material.rgba if np.allclose(own, _PLAIN) else own
        look: Json = {
            name: getattr(material, name).item() for name in ("specular", "shininess", "emission")
        }
        texture = int(material.texid[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)])
        if texture >= 0 and m.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D:
            look["texture"] = self._texture(texture)
            look["repeat"] = _floats(material.texrepeat)
            look["uniform"] = bool(material.texuniform.item())
        elif texture >= 0:
            mean = self._pixels(texture).reshape(-1, m.tex_nchannel[texture]).mean(axis=0) / 255
            chosen = [*(mean[:3] * chosen[:3]), chosen[3]]
        return look, _floats(chosen, 4)

    def _pixels(self, texture: int) -> NDArray[np.uint8]:
        m = self._model
        shape = m.tex_height[texture], m.tex_width[texture], m.tex_nchannel[texture]
        first = m.tex_adr[texture]
        return np.asarray(m.tex_data[first : first + np.prod(shape)]).reshape(shape)

    def _texture(self, texture: int) -> int:
        """Return the index of a texture in the page: RGBA from the lower left."""
        if texture not in self.textures:
            pixels = self._pixels(texture)
            height, width, channels = pixels.shape
            tall, wide = -(-height // TEXTURE_SIDE), -(-width // TEXTURE_SIDE)  # pixels made one
            rows, columns = height // tall, width // wide
            whole = pixels[: rows * tall, : columns * wide]
            small = whole.reshape(rows, tall, columns, wide, channels).mean(axis=(1, 3))
            rgba = np.full((rows, columns, 4), 255, np.uint8)
            rgba[..., :3] = small[..., :3] if channels >= RGB else small[..., :1]
            if channels > RGB:
                rgba[..., 3] = small[..., 3]
            data = pack(rgba[::-1].tobytes())
            self.textures[texture] = {"width": columns, "height": rows, "pixels": data}
        return list(self.textures).index(texture)

    def _mesh(self, key: tuple[bool, int]) -> int:
        """Return the index of a mesh in the page."""
        if key not in self.meshes:
            is_field, index = key
            self.meshes[key] = _packed(*(self._field if is_field else self._triangles)(index))
        return list(self.meshes).index(key)

    def _triangles(self, mesh: int) -> tuple[Any, Any, Any]:
        """Return a mesh's vertices (n, 3), faces (k, 3) and texture coordinates (3k, 2) or None."""
        m = self._model
        first, count = m.mesh_vertadr[mesh], m.mesh_vertnum[mesh]
        faces = slice(m.mesh_faceadr[mesh], m.mesh_faceadr[mesh] + m.mesh_facenum[mesh])
        vertices = m.mesh_vert[first : first + count]
        if m.mesh_texcoordadr[mesh] < 0:
            return vertices, m.mesh_face[faces], None
        points = m.mesh_texcoord[m.mesh_texcoordadr[mesh] :]
        return vertices, m.mesh_face[faces], points[m.mesh_facetexcoord[faces].ravel()]

    def _field(self, field: int) -> tuple[Any, Any, None]:
        """Return a height field's surface as a mesh."""
        m = self._model
        rows, columns = int(m.hfield_nrow[field]), int(m.hfield_ncol[field])
        x_half, y_half, top, _ = m.hfield_size[field]
        first = m.hfield_adr[field]
        height = m.hfield_data[first : first + rows * columns] * top
        across, along = np.linspace(-x_half, x_half, columns), np.linspace(-y_half, y_half, rows)
        x, y = np.meshgrid(across, along)
        a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        b, c, d = a + 1, a + columns, a + columns + 1
        faces = np.concatenate((np.stack((a, b, d), 1), np.stack((a, d, c), 1)))
        return np.stack((x.ravel(), y.ravel(), height), axis=1), faces, None


def _packed(vertices: Any, faces: Any, texture: Any) -> Json:
    """Encode a mesh: vertices in 1/65535 of its box, differences of vertex indices."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    whole = np.rint((vertices - low) / span * 65535).astype("<u2")
    steps = np.diff(faces.ravel().astype(np.int64), prepend=0).astype("<i4")
    mesh: Json = {
        "low": _floats(low, 7),
        "span": _floats(span, 7),
        "vertices": pack(whole.tobytes()),
        "faces": pack(steps.tobytes()),
    }
    if texture is not None:
        mesh["texture"] = pack(np.asarray(texture, "<f4").tobytes())
    return mesh
