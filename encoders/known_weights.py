"""The weights that there are adapters for: where they come from and how they are known."""

from __future__ import annotations

from dataclasses import dataclass

SINGLE = (".safetensors", ".pt")  # endings of weights that are one file


@dataclass(frozen=True)
class WeightsEntry:
    """A set of weights.

    Args:
        file: name in the weights folder; a release folder where it has no ending of
            :data:`SINGLE`.
        sha256: the hashes of known releases; others are accepted once locked.
        licence: SPDX name.
        hub: repository on the Hugging Face hub; ``None`` where no hub has them.
        revision: commit of the hub repository; ``None`` is resolved and locked by the first fetch.
        about: one line for people.
        packaged: whether they are our own and lie in the package.
        url: of the file, where it is released elsewhere than on the hub.
    """

    file: str
    sha256: tuple[str, ...]
    licence: str
    hub: str | None
    revision: str | None
    about: str
    packaged: bool = False
    url: str | None = None

    @property
    def is_folder(self) -> bool:
        """Whether the weights are a release folder."""
        return not self.file.endswith(SINGLE)

    def how_to_get(self, name: str) -> str:
        """What to do where the weights ``name`` are not here."""
        if self.packaged:
            return "installing vidphys again: they are a part of it"
        released = self.hub or self.url
        return f"`vidphys weights fetch {name}`" if released else "another way: no hub has them"


def _released(name: str, hub: str, licence: str, about: str) -> WeightsEntry:
    """A release folder whose revision and hash are locked when it is first fetched."""
    return WeightsEntry(name, (), licence, hub, None, about)


def _own(name: str, sha256: str, about: str) -> WeightsEntry:
    """One that ``python -m vidphys.pretraining`` made and the package holds."""
    return WeightsEntry(name, (sha256,), "Apache-2.0", None, None, about, packaged=True)


KNOWN = {
    "hiera": WeightsEntry(
        file="sam2_hiera_tiny.safetensors",
        sha256=("1783be247fa6b056d3dbaba07bcbf3dbe1652533d15cddf5749d5ee553dc2a75",),
        licence="Apache-2.0",
        hub="timm/sam2_hiera_tiny.fb_r896",
        revision=None,
        about="SAM 2 image trunk, Hiera-Tiny, 26.85 M parameters (arXiv:2408.00714)",
    ),
    "i3d": WeightsEntry(
        file="i3d_kinetics400.safetensors",
        sha256=("5a8c8e46225f10945b68a4c0e738cdf380bb6492401c9f38b0b5925cdfbb1413",),
        licence="Apache-2.0",
        hub=None,
        revision=None,
        about="Inception-v1 I3D, RGB, Kinetics-400, 12.70 M parameters (arXiv:1705.07750)",
    ),
    **{
        f"dinov2-{size}": _released(
            f"dinov2-{size}",
            f"timm/vit_{size}_patch14_dinov2.lvd142m",
            "Apache-2.0",
            f"DINOv2 {size}, image transformer, {parameters} M parameters (arXiv:2304.07193)",
        )
        for size, parameters in (("small", 22), ("base", 86), ("large", 304))
    },
    # the hub has no self-supervised small one: this is the one fine-tuned on Kinetics
    "videomae-small": _released(
        "videomae-small",
        "MCG-NJU/videomae-small-finetuned-kinetics",
        "CC-BY-NC-4.0",
        "VideoMAE small, fine-tuned on Kinetics-400, 22 M parameters (arXiv:2203.12602)",
    ),
    "videomae-base": _released(
        "videomae-base",
        "MCG-NJU/videomae-base",
        "CC-BY-NC-4.0",
        "VideoMAE base, self-supervised on Kinetics-400, 86 M parameters (arXiv:2203.12602)",
    ),
    **{
        f"vjepa2-{size}": _released(
            f"vjepa2-{size}",
            f"facebook/vjepa2-vit{size}-fpc64-256",
            "MIT",
            f"V-JEPA 2 ViT-{size}, {parameters} M parameters (arXiv:2506.09985)",
        )
        for size, parameters in (("l", 300), ("h", 600), ("g", 1000))
    },
    "vjepa2-ac": WeightsEntry(
        file="vjepa2-ac-vitg.pt",
        sha256=(),
        licence="MIT",
        hub=None,
        revision=None,
        about="V-JEPA 2-AC ViT-g and its predictor, 1300 M parameters (arXiv:2506.09985)",
        url="https://dl.fbaipublicfiles.com/vjepa2/vjepa2-ac-vitg.pt",
    ),
    "dino-tiny": _own(
        "dino-tiny",
        "17887e6edfbc2843ab46bdaa66fae2e1f38369e7068f10ab819d7cea455bea68",
        "our own image transformer, self-distilled on rendered worlds, 0.37 M parameters",
    ),
    "videomae-tiny": _own(
        "videomae-tiny",
        "4f0a9d8eb27050ebf211e1545abcc199aae79fcef4b356164f3a73a60e6307fe",
        "our own video transformer, masked autoencoding of rendered worlds, 0.34 M parameters",
    ),
    "vjepa2-tiny": _own(
        "vjepa2-tiny",
        "4ef2b050953b75431f083b21b4302946b1e83ffc7ac5558de9a91e17bc509daf",
        "our own video transformer, feature prediction in rendered worlds, 0.34 M parameters",
    ),
}


def entry(name: str) -> WeightsEntry:
    """The table's entry.

    Raises:
        ValueError: unknown name.
    """
    if name not in KNOWN:
        raise ValueError(f"weights: unknown name {name!r}; known are {', '.join(KNOWN)}")
    return KNOWN[name]
