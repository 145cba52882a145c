"""The exceptions of the package. Their text is one line, written for the person who made the input."""


class BayesterraError(Exception):
    """Base of everything that the package raises on purpose."""


class StudyError(BayesterraError, ValueError):
    """A study file, a table of measurements or a prior that cannot be used as it stands."""


class ResultError(BayesterraError, ValueError):
    """A result folder that cannot be read or written."""


class EngineError(BayesterraError, RuntimeError):
    """Workers that cannot be reached, do not fit together, or die."""


class SupportError(BayesterraError, ValueError):
    """No parameter set that the prior allows can explain the conditions of the data."""
