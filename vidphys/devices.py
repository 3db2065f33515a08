"""A device that was asked for: whether it is there, what it is, and how exactly it computes."""

from __future__ import annotations

from vidphys.errors import InputError


def prepare_device(device: str) -> None:
    """Refuse CUDA where there is none, and keep it from rounding what goes into a convolution.

    Left alone, torch convolves on a card with ten bits of each number (TF32), which what learns to
    see is trained through. This holds for the whole process.

    Raises:
        InputError: CUDA is asked for and this machine has no such device.
    """
    if device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise InputError("`device` cuda: this machine has no CUDA device; use cpu")
    torch.backends.cudnn.allow_tf32 = False


def device_name(device: str) -> str:
    """As records say it: with the card's own name.

    Example:
        >>> device_name("cpu")
        'cpu'
    """
    if device == "cpu":
        return device
    import torch

    return f"{device} ({torch.cuda.get_device_name()})"
