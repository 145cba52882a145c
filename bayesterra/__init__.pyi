"""Public names of the package and their homes, for checkers of types, for editors, and for ``__init__.py``."""

from bayesterra.analysis.comparison import compare as compare
from bayesterra.analysis.inference import run_prior as run_prior
from bayesterra.analysis.run import load_result as load_result
from bayesterra.analysis.run import run as run
from bayesterra.analysis.run import soil_test as soil_test
from bayesterra.analysis.simulation import simulate as simulate
from bayesterra.checking.calibration import calibrate as calibrate
from bayesterra.checking.holdout import Holdout as Holdout
from bayesterra.checking.holdout import leave_out as leave_out
from bayesterra.checking.ranks import Calibration as Calibration
from bayesterra.design.choosing import Design as Design
from bayesterra.design.recommendation import recommend as recommend
from bayesterra.errors import BayesterraError as BayesterraError
from bayesterra.errors import EngineError as EngineError
from bayesterra.errors import ResultError as ResultError
from bayesterra.errors import StudyError as StudyError
from bayesterra.errors import SupportError as SupportError
from bayesterra.follow.stream import Stream as Stream
from bayesterra.follow.stream import load_stream as load_stream
from bayesterra.identifiability.analysis import Identified as Identified
from bayesterra.identifiability.analysis import foresee as foresee
from bayesterra.identifiability.analysis import identify as identify
from bayesterra.least_squares.fit import fit as fit
from bayesterra.least_squares.results import Fit as Fit
from bayesterra.likelihood.posterior import Posterior as Posterior
from bayesterra.likelihood.posterior import posterior as posterior
from bayesterra.models import ModelParameter as ModelParameter
from bayesterra.models import Soil as Soil
from bayesterra.models import Wheel as Wheel
from bayesterra.prediction.outlook import predict_rover as predict_rover
from bayesterra.prediction.prediction import predict as predict
from bayesterra.prediction.rover import Rover as Rover
from bayesterra.runtime.checkpoints import read_tasks as read_tasks
from bayesterra.runtime.engines import Engine as Engine
from bayesterra.runtime.engines import dask_cluster as dask_cluster
from bayesterra.runtime.engines import in_process as in_process
from bayesterra.runtime.engines import local_pool as local_pool
from bayesterra.stats.laws import Law as Law
from bayesterra.study.noise import Noise as Noise
from bayesterra.study.priors import Prior as Prior
from bayesterra.study.result import Result as Result
from bayesterra.study.study import Study as Study
from bayesterra.study.study import load_soil_test as load_soil_test
from bayesterra.study.study import load_study as load_study

__version__: str
__all__: list[str]
