"""Where networks run."""

import torch

from multilight.datagen.errors import UserError


def chosen_device(name: str) -> torch.device:
    """Return the device of that name; "auto" is the GPU where there is one. Raises `UserError` for one that is not."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        torch.zeros(1, device=name).item()
        return torch.device(name)
    # Torch says so in as many ways as it has kinds of device.
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise UserError(f"device {name!r} cannot be used: {str(error).splitlines()[0]}; try cpu, or auto") from None
