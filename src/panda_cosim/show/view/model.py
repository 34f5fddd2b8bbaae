"""Describes a MuJoCo model for the page: bodies, joints, shapes, meshes, textures, cameras."""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...fmus.errors import InputError, one_line
from ...task.files import MODEL_FILE
from .columns import pack

GROUPS: Final = 3  # the groups that MuJoCo's own viewer shows: 0, 1, 2
TEXTURE_SIDE: Final = 128  # [px] largest texture; larger ones are scaled down
RGB: Final = 3  # channels
SHAPES: Final = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_HFIELD: "mesh",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
    mujoco.mjtGeom.mjGEOM_SDF: "mesh",
}
JOINTS: Final = {
    mujoco.mjtJoint.mjJNT_FREE: "free",
    mujoco.mjtJoint.mjJNT_BALL: "ball",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
}
_PLAIN = (0.5, 0.5, 0.5, 1.0)  # a geom's default colour


def describe(model: Any) -> dict[str, Any]:
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
        "meshes": shapes.meshes,
        "textures": shapes.textures,
        "cameras": [_camera(model, camera) for camera in range(model.ncam)],
        "center": _floats(model.stat.center),
        "extent": float(model.stat.extent),
    }


def _floats(values: Any, digits: int = 5) -> list[float]:
    return [round(float(value), digits) for value in np.ravel(values)]


def _body(model: Any, body: int, shapes: _Shapes) -> dict[str, Any]:
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    geoms = np.flatnonzero(model.geom_bodyid == body).tolist()
    sites = np.flatnonzero(model.site_bodyid == body).tolist()
    drawn = [shapes.geom(geom) for geom in geoms] + [shapes.site(site) for site in sites]
    return {
        "name": model.body(body).name,
        "parent": int(model.body_parentid[body]),
        "fixed": int(model.body_weldid[body]) == 0,
        "pos": _floats(model.body_pos[body], 9),
        "quat": _floats(model.body_quat[body], 9),
        "com": _floats(model.body_ipos[body], 9),
        "mass": float(model.body_mass[body]),
        "joints": [_joint(model, joint) for joint in range(first, first + count)],
        "shapes": [shape for shape in drawn if shape is not None],
    }


def _joint(model: Any, joint: int) -> dict[str, Any]:
    address = int(model.jnt_qposadr[joint])
    limits = model.jnt_range[joint] if model.jnt_limited[joint] else ()
    return {
        "name": model.joint(joint).name,
        "kind": JOINTS[mujoco.mjtJoint(int(model.jnt_type[joint]))],
        "address": address,
        "axis": _floats(model.jnt_axis[joint], 9),
        "pos": _floats(model.jnt_pos[joint], 9),
        "zero": float(model.qpos0[address]),
        "range": _floats(limits, 6),
    }


def _camera(model: Any, camera: int) -> dict[str, Any]:
    """Return a camera in the frame of its body; quaternion (w, x, y, z), it looks along -z."""
    return {
        "name": model.camera(camera).name or f"camera {camera + 1}",
        "body": int(model.cam_bodyid[camera]),
        "pos": _floats(model.cam_pos[camera]),
        "quat": _floats(model.cam_quat[camera], 7),
        "fovy": float(model.cam_fovy[camera]),
    }


class _Shapes:
    """Geoms and sites; each mesh and texture they use is kept once."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self.meshes: list[dict[str, Any]] = []
        self.textures: list[dict[str, Any]] = []
        self._mesh_index: dict[tuple[str, int], int] = {}
        self._texture_index: dict[int, int] = {}

    def geom(self, geom: int) -> dict[str, Any] | None:
        """Return a geom, or None if it is not shown."""
        m = self._model
        kind = SHAPES.get(mujoco.mjtGeom(int(m.geom_type[geom])))
        look = self._look(int(m.geom_matid[geom]), m.geom_rgba[geom])
        if kind is None or m.geom_group[geom] >= GROUPS or look["rgba"][3] == 0.0:
            return None
        frame = {"pos": _floats(m.geom_pos[geom]), "quat": _floats(m.geom_quat[geom], 7)}
        shape = {"kind": kind, "size": _floats(m.geom_size[geom]), **frame, **look}
        if kind == "mesh":
            is_field = m.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD
            key = ("hfield" if is_field else "mesh", int(m.geom_dataid[geom]))
            shape["mesh"] = self._mesh(key)
        return shape

    def site(self, site: int) -> dict[str, Any] | None:
        """Return a site, or None if it is not shown."""
        m = self._model
        look = self._look(int(m.site_matid[site]), m.site_rgba[site])
        if m.site_group[site] >= GROUPS or look["rgba"][3] == 0.0:
            return None
        return {
            "kind": SHAPES[mujoco.mjtGeom(int(m.site_type[site]))],
            "size": _floats(m.site_size[site]),
            "pos": _floats(m.site_pos[site]),
            "quat": _floats(m.site_quat[site], 7),
            **look,
        }

    def _look(self, material: int, rgba: Any) -> dict[str, Any]:
        """Return colour, gloss and texture; its own colour overrides the material's."""
        if material < 0:
            return {"rgba": _floats(rgba, 4)}
        m = self._model
        chosen = m.mat_rgba[material] if np.allclose(rgba, _PLAIN) else rgba
        look = {
            "rgba": _floats(chosen, 4),
            "specular": float(m.mat_specular[material]),
            "shininess": float(m.mat_shininess[material]),
            "emission": float(m.mat_emission[material]),
        }
        role = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
        texture = int(m.mat_texid[material][role])
        if texture >= 0 and m.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D:
            look["texture"] = self._texture(texture)
            look["repeat"] = _floats(m.mat_texrepeat[material])
            look["uniform"] = bool(m.mat_texuniform[material])
        elif texture >= 0:
            mean = self._pixels(texture).reshape(-1, m.tex_nchannel[texture]).mean(axis=0) / 255
            look["rgba"] = _floats([*(mean[:3] * chosen[:3]), chosen[3]], 4)
        return look

    def _pixels(self, texture: int) -> NDArray[np.uint8]:
        m = self._model
        shape = m.tex_height[texture], m.tex_width[texture], m.tex_nchannel[texture]
        first = m.tex_adr[texture]
        return np.asarray(m.tex_data[first : first + np.prod(shape)]).reshape(shape)

    def _texture(self, texture: int) -> int:
        """Return the index of a texture in the page: RGBA from the lower left."""
        if texture not in self._texture_index:
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
            self._texture_index[texture] = len(self.textures)
            data = pack(rgba[::-1].tobytes())
            self.textures.append({"width": columns, "height": rows, "pixels": data})
        return self._texture_index[texture]

    def _mesh(self, key: tuple[str, int]) -> int:
        """Return the index of a mesh in the page."""
        if key not in self._mesh_index:
            kind, index = key
            triangles = self._field(index) if kind == "hfield" else self._triangles(index)
            self._mesh_index[key] = len(self.meshes)
            self.meshes.append(_pack_mesh(*triangles))
        return self._mesh_index[key]

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
        x, y = np.meshgrid(
            np.linspace(-x_half, x_half, columns), np.linspace(-y_half, y_half, rows)
        )
        a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        b, c, d = a + 1, a + columns, a + columns + 1
        faces = np.concatenate((np.stack((a, b, d), 1), np.stack((a, d, c), 1)))
        return np.stack((x.ravel(), y.ravel(), height), axis=1), faces, None


def _pack_mesh(vertices: Any, faces: Any, texture: Any) -> dict[str, Any]:
    """Encode a mesh: vertices in 1/65535 of its box, differences of vertex indices."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    whole = np.rint((vertices - low) / span * 65535).astype("<u2")
    steps = np.diff(faces.ravel().astype(np.int64), prepend=0).astype("<i4")
    mesh = {
        "low": _floats(low, 7),
        "span": _floats(span, 7),
        "vertices": pack(whole.tobytes()),
        "faces": pack(steps.tobytes()),
    }
    if texture is not None:
        mesh["texture"] = pack(np.asarray(texture, "<f4").tobytes())
    return mesh
