"""Cell models with their compiled functions in place of those by NumPy: for whoever makes maps."""

from ogm_core.cells import rate_kernel
from ogm_core.cells.model import CellModel
from ogm_core.cells.rate import Rate


def compiled(model: CellModel) -> CellModel:
    """The same model; what it publishes is made many times faster."""
    return Rate(rate_kernel.publish, model.free_below) if isinstance(model, Rate) else model
