"""Compiled evaluation of eight lanes by one of the models."""

from bayesterra.models.kernels.arc import assemble, measure
from bayesterra.models.kernels.closed_form import close
from bayesterra.models.kernels.compiler import Lanes, called
from bayesterra.models.kernels.integral import integrate
from bayesterra.models.kernels.load_effect import close_under_load, scale_pull

Kind = tuple[int, ...]
"""A model: how many numbers there are is a type, so no code is made of other branches; all 1 for M3, else 0."""
M1, M2_OR_M3, M2L = 1, 2, 3


@called
def evaluate(ws: Lanes, kind: Kind, which: int) -> None:
    """Fill the results from the inputs; `which` is the quadrature rule of M1."""
    measure(ws)
    if len(kind) == M1:
        integrate(ws, which)
    elif len(kind) == M2L:
        close_under_load(ws)
    else:
        close(ws, kind[0] == 1)
    assemble(ws)
    if len(kind) == M2L:
        scale_pull(ws)
