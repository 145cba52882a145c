"""The workspace: eight (parameter set, row) pairs side by side, one vector register per quantity.

A workspace is a flat array of float64, or of complex128 for derivatives; quantity Q of lane i sits at Q + i.
Constant offsets into one array let LLVM prove that nothing overlaps, so loops over lanes become vector code.
"""

LANES = 8
PARAMETERS = 9
ROW_COLUMNS = 6
EFFECT_PARAMETERS = 4


def _offsets(first: int, count: int) -> range:
    return range(first * LANES, (first + count) * LANES, LANES)


# Inputs: the nine soil parameters, the sinkage, the columns of a row.
INPUTS = 0
KS, N0, N1, C, PHI, K, C1, C2, C3, Z = _offsets(0, 10)
SLIP, EXPONENT_SLIP, RADIUS, WIDTH, START_RADIUS, SHEARING_RADIUS = _offsets(10, 6)
ROW = SLIP

# The arc: half-widths of its front and rear part, sine and cosine of theta_1 and theta_2, shear displacement
# over r_s at both, and what the stresses need.
FRONT, REAR, SIN_1, COS_1, SIN_2, COS_2, THETA_2, JOIN_1, JOIN_2 = _offsets(16, 9)
N, TAN_PHI, RS_OVER_K = _offsets(25, 3)

# Integrals over the front (1) and rear (2) part: sigma cos, sigma sin, tau cos, tau sin, tau.
SC1, SS1, TC1, TS1, T1 = _offsets(28, 5)
SC2, SS2, TC2, TS2, T2 = _offsets(33, 5)
SUMS = 5

# Results: the three forces, then the components in the order of forces.Components.
NORMAL, PULL, MOMENT = _offsets(38, 3)
N_SIGMA_1, N_SIGMA_2, N_TAU_1, N_TAU_2, PULL_TAU_1, PULL_TAU_2, PULL_SIGMA_1, PULL_SIGMA_2 = _offsets(41, 8)
RESULTS = NORMAL

# The sinkage solver: load; log z and log(F_N / W) now and before; the slope between them, how far it may be
# wrong, the step it spans; bracket, highest log z, lane done or not; other forces before, their slopes.
LOAD, X, F, X_BEFORE, F_BEFORE, SLOPE, DOUBT, STEP, LOW, HIGH, TOP, DONE = _offsets(49, 12)
PULL_BEFORE, MOMENT_BEFORE, PULL_SLOPE, MOMENT_SLOPE = _offsets(61, 4)

# The load effect of M2L: further columns of its parameter sets and of its rows; what multiplies F_DP; what is
# under the root in F_N, negative where (42) has no F_N.
CP1, CP2, CDP, CM, MEAN_LOAD = _offsets(65, 5)
PULL_FACTOR, UNDER_ROOT = _offsets(70, 2)
EFFECTS = CP1
SIZE = 72 * LANES
