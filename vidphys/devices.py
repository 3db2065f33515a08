"""Whether a device that was asked for is there, and what it is."""

from __future__ import annotations

from vidphys.errors import InputError


def check_cuda(device: str) -> None:
    """Refuse CUDA where there is none.

    Raises:
        InputError: CUDA is asked for and this machine has no such device.
    """
    if device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise InputError("`device` cuda: this machine has no CUDA device; use cpu")


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
