"""Soil arrays: one layout of named columns, of which every model takes those that it names."""

import numpy as np
import pytest

from bayesterra.likelihood.forward import model_columns, offset_of, soil_at
from bayesterra.models import LOAD_EFFECT_FIELDS, M1, M2L, SOIL_FIELDS, Soil
from bayesterra.parameters import PARAMETERS, PRIOR_PARAMETERS, SoilColumns, soil_array

SOIL = Soil(Ks=2.5e6, n0=0.76, n1=1.3, c=250.0, phi=0.55, K=0.012, c1=0.5, c2=-0.3, c3=-0.1)


def test_every_parameter_of_a_prior_has_its_column() -> None:
    """The models' own parameters stand in their order, with moduli and zero error between."""
    assert (*SOIL_FIELDS, "kc", "kphi", "sinkage_offset", *LOAD_EFFECT_FIELDS) == tuple(PRIOR_PARAMETERS[:16])
    assert set(PRIOR_PARAMETERS) <= set(PARAMETERS)
    assert [SoilColumns[name] for name in PRIOR_PARAMETERS[:16]] == list(range(16))


def test_values_stand_under_their_names() -> None:
    """What is not stated is NaN, the zero error of the sinkage 0; one value serves every set."""
    soil = soil_array({"phi": [0.5, 0.6], "Ks": 1e6, "noise_sinkage": 3.0})
    assert soil.shape == (2, len(PRIOR_PARAMETERS))
    assert soil[:, SoilColumns.phi].tolist() == [0.5, 0.6]
    assert soil[:, SoilColumns.Ks].tolist() == [1e6, 1e6]
    assert offset_of(soil).tolist() == [[0.0], [0.0]]
    assert np.isnan(soil).sum(axis=1).tolist() == [len(PRIOR_PARAMETERS) - 3] * 2


def test_a_model_takes_the_columns_that_it_names() -> None:
    """M1 takes nine, M2L thirteen of the sixteen."""
    soil = soil_array({name: float(i) for i, name in enumerate(PRIOR_PARAMETERS)})
    assert model_columns(soil, M1()).tolist() == [[float(i) for i in range(9)]]
    assert model_columns(soil, M2L(mean_load=80.0))[0].tolist() == [*range(9), *range(12, 16)]
    np.testing.assert_array_equal(model_columns(soil_array(vars(SOIL)), M1())[0], SOIL.as_array())


@pytest.mark.parametrize(("width", "modulus"), [(0.1, 1.1e6), (0.5, 1.02e6)])
def test_a_modulus_belongs_to_a_width(width: float, modulus: float) -> None:
    """K_s = k_c/b + k_φ where these are used, NaN where that is not positive, else as it stands."""
    plain = soil_array(vars(SOIL))
    assert soil_at(plain, width) is plain
    soil = soil_array({**vars(SOIL), "kc": [1e4, -1e7], "kphi": 1e6})
    under = soil_at(soil, width)
    assert under[0, SoilColumns.Ks] == pytest.approx(modulus)
    assert np.isnan(under[1, SoilColumns.Ks])
    np.testing.assert_array_equal(np.delete(under, SoilColumns.Ks, axis=1), np.delete(soil, 0, axis=1))
    assert soil[0, SoilColumns.Ks] == SOIL.Ks
