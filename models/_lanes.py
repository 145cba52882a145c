"""The workspace: eight (parameter set, row) pairs side by side, one vector register per quantity.

A workspace is a flat array of float64 or complex128; quantity Q of lane l sits at Q + l. Constant offsets into
one array let LLVM prove that nothing overlaps, so that the loops over lanes become vector code.
"""

import numpy as np

LANES = 8

# Inputs: the nine soil parameters, sinkage, then the columns of a row.
INPUTS = 0
KS, N0, N1, C, PHI, K, C1, C2, C3, Z = (INPUTS + i * LANES for i in range(10))
ROW = 10 * LANES
SLIP, EXPONENT_SLIP, RADIUS, WIDTH, START_RADIUS, SHEARING_RADIUS = (ROW + i * LANES for i in range(6))
ROW_COLUMNS = 6

# Geometry: half-widths of the front and rear parts, sines and cosines of theta_1 and theta_2, the shear
# displacements there over r_s, and what the stresses need.
GEOMETRY = 16 * LANES
FRONT, REAR, SIN_1, COS_1, SIN_2, COS_2, THETA_2, JOIN_1, JOIN_2, N, TAN_PHI, RS_OVER_K = (
    GEOMETRY + i * LANES for i in range(12)
)

# Integrals over the front (1) and rear (2) part: S sigma, T tau; C cosine, S sine.
SUMS = 28 * LANES
SC1, SC2, SS1, SS2, TC1, TC2, TS1, TS2, T1, T2 = (SUMS + i * LANES for i in range(10))

# Results: the three forces, and the components in the order of forces.Components.
RESULTS = 38 * LANES
NORMAL, PULL, MOMENT = (RESULTS + i * LANES for i in range(3))
COMPONENTS = 41 * LANES

# The sinkage solver's state.
SOLVER = 49 * LANES
LOAD, X, F, X_BEFORE, F_BEFORE, SLOPE, LOW, HIGH, TOP, PULL_BEFORE, MOMENT_BEFORE, DONE = (
    SOLVER + i * LANES for i in range(12)
)
SIZE = 61 * LANES

DTYPES = (np.float64, np.complex128)
