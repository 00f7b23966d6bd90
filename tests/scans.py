"""Skin scans of bodies of known size, as a scanner would give them, for tests and benchmarks."""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from spinestiff.anatomy.axes import body_axes
from spinestiff.anatomy.rotation import exp_so3
from spinestiff.anatomy.template import template_torso
from spinestiff.personalise.skin_surface import skin_surface

HEIGHT = 157.0
YAW, TILT, SHIFT = 20.0, 2.0, np.array([300.0, -200.0, 150.0])
# The scanner's axes: z up, y backwards.
AXES = body_axes("+x", "+z", "-y")


@cache
def body(mass, mesh="coarse"):
    """A girl of so many kg."""
    return template_torso(HEIGHT, mesh, age_years=13.0, sex="female", mass_kg=mass)


def arm(side):
    """A closed tube that hangs beside the trunk, from the shoulder to the hip."""
    tube = trimesh.creation.cylinder(radius=38.0, height=520.0, sections=24)
    for _ in range(3):
        tube = tube.subdivide()
    turn = exp_so3(np.array([-np.pi / 2, 0.0, 0.0]))
    lean = exp_so3(np.array([0.0, 0.0, side * np.deg2rad(6.0)]))
    return trimesh.Trimesh(tube.vertices @ turn.T @ lean.T + [side * 262.0, 80.0, -20.0], tube.faces)


def surface(torso, keep=lambda p: np.ones(len(p), bool), arms=False, noise=1.0, size=12.0):
    """The open skin of a torso as a mesh of a scanner's kind, world mm: without floor and lid, fine and noisy."""
    skin = skin_surface(torso)
    ends = np.unique(skin.face[skin.ends])
    faces = np.delete(skin.faces, ends, axis=0)
    mesh = trimesh.Trimesh(torso.tissue.rest_positions, faces, process=False).subdivide_to_size(size)
    mesh.update_faces(keep(mesh.triangles_center))
    mesh.remove_unreferenced_vertices()
    mesh.vertices += noise * np.random.default_rng(5).normal(size=mesh.vertices.shape)
    return trimesh.util.concatenate([mesh, arm(-1), arm(1)]) if arms else mesh


def written(mesh, path, unit=1.0, yaw=YAW, tilt=TILT):
    """The mesh in the scanner's frame and unit, turned, leaning and elsewhere."""
    turn = exp_so3(np.array([0.0, np.deg2rad(yaw), 0.0])) @ exp_so3(np.array([np.deg2rad(tilt), 0.0, 0.0]))
    moved = (mesh.vertices @ turn.T + SHIFT) @ AXES / unit
    trimesh.Trimesh(moved, mesh.faces, process=False).export(path)
    return path


def errors(torso, truth, where=lambda p: np.ones(len(p), bool)):
    """Distances (n,) mm from the torso's skin to the true one."""
    skin, true = skin_surface(torso), skin_surface(truth, 5.0)
    points = skin.points[~skin.ends]
    points = points[where(points)]
    near = cKDTree(true.points).query(points)[1]
    return np.abs(np.einsum("ni,ni->n", points - true.points[near], true.normals[near]))
