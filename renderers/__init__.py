"""Positions in, frames out: differentiable splats and the worlds made of them."""

from renderers.antialias import supersampled
from renderers.camera import Camera
from renderers.centroid import centroids
from renderers.splats import disk_coverage, disks, gaussian_sum, gaussians
from renderers.worlds import PALETTE, WORLDS, AnonymousWorld, ChannelWorld, RgbWorld, World

__all__ = [
    "PALETTE",
    "WORLDS",
    "AnonymousWorld",
    "Camera",
    "ChannelWorld",
    "RgbWorld",
    "World",
    "centroids",
    "disk_coverage",
    "disks",
    "gaussian_sum",
    "gaussians",
    "supersampled",
]
