"""Compiled evaluation of eight lanes by one of the models."""

from bayesterra.models.kernels.arc import assemble, measure
from bayesterra.models.kernels.closed_form import close
from bayesterra.models.kernels.compiler import Lanes, called
from bayesterra.models.kernels.integral import integrate
from bayesterra.models.kernels.load_effect import close_under_load, scale_pull

M1, M2, M3, M2L = 1, 2, 3, 4


@called
def evaluate(ws: Lanes, model: int, which: int) -> None:
    """Fill the results from the inputs; `which` is the quadrature rule of M1."""
    measure(ws)
    if model == M1:
        integrate(ws, which)
    elif model == M2L:
        close_under_load(ws)
    else:
        close(ws, model == M3)
    assemble(ws)
    if model == M2L:
        scale_pull(ws)
