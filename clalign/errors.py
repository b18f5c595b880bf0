"""The exceptions and warnings that users of clalign may want to catch."""

from __future__ import annotations


class ClalignError(Exception):
    """Base of every error that clalign raises on purpose."""


class InputError(ClalignError, ValueError):
    """The user's input cannot be used as it is; the message says what, where and what to do."""


class MeshError(InputError):
    """A mesh cannot be read, or has a defect that the method cannot work with."""


class OptionError(InputError):
    """An option has an unknown name or a value outside its range."""


class ResultError(InputError):
    """A saved result, map or truth file cannot be read or does not fit its meshes."""


class DeviceError(ClalignError, RuntimeError):
    """No usable OpenCL device, or a device failed while working."""


class MemoryBudgetError(DeviceError):
    """The work needs more memory than the device or the machine has; raised before allocating, as far as is known."""


class ConvergenceError(ClalignError, RuntimeError):
    """A numerical solver did not reach the accuracy that the next step relies on."""


class ClalignWarning(UserWarning):
    """Base of the warnings that end up in `Correspondence.warnings`."""


class ConfidenceWarning(ClalignWarning):
    """The chosen map is hardly better than a different one."""
