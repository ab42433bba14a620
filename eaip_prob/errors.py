"""Every error and warning that the package raises on purpose.

A message says what was expected, what came, in which argument, and what to do. All errors derive from
`EaipError`, so that one `except` clause catches what the package refuses and nothing else.
"""


class EaipError(Exception):
    """Base class of all errors of this package."""


class InputError(EaipError, ValueError):
    """An argument has the right type but a value that cannot be used."""


class ShapeError(InputError):
    """A tensor has the wrong shape."""


class UnitsError(InputError):
    """A quantity is given in other units than the argument is documented to take."""


class DataFileError(InputError):
    """A file is damaged, truncated, of another kind, or holds what is never loaded (pickled objects)."""


class MissingDataError(EaipError, FileNotFoundError):
    """Recorded data that an experiment reads are not where `data_dir` says."""


class StorageError(EaipError, OSError):
    """Results cannot be written: the disk is full, a quota is used up, or the folder is read-only."""


class NotFittedError(EaipError, RuntimeError):
    """A method that needs `fit` was called before it."""


class NotPositiveDefiniteError(EaipError, ArithmeticError):
    """A matrix that must be a covariance has no Cholesky factor, even with jitter."""


class MissingExtraError(EaipError, ImportError):
    """An optional package is not installed; the message holds the exact install command."""


class NumericalWarning(UserWarning):
    """Round-off needed a correction; the message names its size."""


class HeldOutWarning(UserWarning):
    """Nothing could be left out, so that stated defaults stand where a choice on held-out groups would be."""


class ExtrapolationWarning(UserWarning):
    """A prediction was asked for something far from what was demonstrated; the message says what."""
