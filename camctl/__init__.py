"""camctl: a camera controller that knows which exposures to combine.

Everything in `camctl.__all__` is public.  ``import camctl`` itself is cheap: the module that
defines a name, and numpy with it, is imported when the name is first used.

>>> import camctl
>>> with camctl.open_camera("sim", scene="tile-floor", size="64x48") as camera:
...     report = camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 4, 16)))
>>> report.radiance().shape
(48, 64)
"""

__version__ = "0.2.0"

TYPE_CHECKING = False  # type checkers take it for true; the module typing takes 10 ms to be loaded
if TYPE_CHECKING:
    from camctl import calibrate as calibrate
    from camctl.captures.plan import plan_capture as plan_capture
    from camctl.captures.sequence import Progress as Progress
    from camctl.captures.sequencer import capture as capture
    from camctl.captures.sequencer import resume as resume
    from camctl.errors import CamctlError as CamctlError
    from camctl.errors import CameraBusyError as CameraBusyError
    from camctl.errors import CameraClosedError as CameraClosedError
    from camctl.errors import CameraDisconnectedError as CameraDisconnectedError
    from camctl.errors import CameraError as CameraError
    from camctl.errors import CameraNotFoundError as CameraNotFoundError
    from camctl.errors import CameraProtocolError as CameraProtocolError
    from camctl.errors import CameraTimeoutError as CameraTimeoutError
    from camctl.errors import CaptureError as CaptureError
    from camctl.errors import DataError as DataError
    from camctl.errors import InterruptedCaptureError as InterruptedCaptureError
    from camctl.errors import OutOfMemoryError as OutOfMemoryError
    from camctl.errors import RefusedSettingError as RefusedSettingError
    from camctl.errors import ResourceError as ResourceError
    from camctl.errors import StorageError as StorageError
    from camctl.errors import UnreachableExposureError as UnreachableExposureError
    from camctl.errors import UsageError as UsageError
    from camctl.evidence.ratio_check import RatioCheck as RatioCheck
    from camctl.exposure.accuracy import AccuracySolution as AccuracySolution
    from camctl.exposure.accuracy import solve_accuracy as solve_accuracy
    from camctl.exposure.evaluation import Evaluation as Evaluation
    from camctl.exposure.evaluation import evaluate as evaluate
    from camctl.exposure.exposure_choices import AccuracyProblem as AccuracyProblem
    from camctl.exposure.exposure_choices import AvailableExposures as AvailableExposures
    from camctl.exposure.exposure_choices import TimeCosts as TimeCosts
    from camctl.exposure.goal import CaptureRequest as CaptureRequest
    from camctl.exposure.light import Metering as Metering
    from camctl.exposure.objective import Objective as Objective
    from camctl.exposure.solver import SearchOptions as SearchOptions
    from camctl.exposure.solver import Solution as Solution
    from camctl.exposure.solver import solve as solve
    from camctl.exposure.table import ExposureTable as ExposureTable
    from camctl.interface.backends import BackendListing as BackendListing
    from camctl.interface.backends import BackendOptions as BackendOptions
    from camctl.interface.backends import CameraBackend as CameraBackend
    from camctl.interface.backends import FrameShape as FrameShape
    from camctl.interface.backends import list_backends as list_backends
    from camctl.interface.backends import list_cameras as list_cameras
    from camctl.interface.camera import Camera as Camera
    from camctl.interface.camera import CameraBase as CameraBase
    from camctl.interface.camera import CameraInfo as CameraInfo
    from camctl.interface.camera import Frame as Frame
    from camctl.interface.camera import FrameStream as FrameStream
    from camctl.interface.camera import OriginalFile as OriginalFile
    from camctl.interface.camera import PreviewingCamera as PreviewingCamera
    from camctl.interface.camera import StreamingCamera as StreamingCamera
    from camctl.interface.clock import CaptureTiming as CaptureTiming
    from camctl.interface.clock import Clock as Clock
    from camctl.interface.clock import RealClock as RealClock
    from camctl.interface.clock import VirtualClock as VirtualClock
    from camctl.interface.controls import Choices as Choices
    from camctl.interface.controls import ExposureControls as ExposureControls
    from camctl.interface.controls import ExposureSetting as ExposureSetting
    from camctl.interface.controls import Layout as Layout
    from camctl.interface.controls import ResponseOrigin as ResponseOrigin
    from camctl.interface.controls import Steps as Steps
    from camctl.interface.cycle import CyclingCamera as CyclingCamera
    from camctl.interface.cycle import FrameCycle as FrameCycle
    from camctl.livestream.result import LiveResult as LiveResult
    from camctl.livestream.stream import Live as Live
    from camctl.livestream.stream import live as live
    from camctl.livestream.video_capture import VideoCapture as VideoCapture
    from camctl.model.noise import FrameNoise as FrameNoise
    from camctl.model.noise import NoiseModel as NoiseModel
    from camctl.model.response.camera import CameraResponse as CameraResponse
    from camctl.model.response.camera import linear_response as linear_response
    from camctl.model.response.camera import standard_response as standard_response
    from camctl.model.response.desired import DesiredResponse as DesiredResponse
    from camctl.model.response.desired import desired_response as desired_response
    from camctl.model.response.measured import measured_response as measured_response
    from camctl.model.response.tabulated import tabulated_desired as tabulated_desired
    from camctl.photographs.merge import merge as merge
    from camctl.photographs.photograph_set import PhotographOptions as PhotographOptions
    from camctl.pictures.combine import Combination as Combination
    from camctl.pictures.combine import combine as combine
    from camctl.profiles.calibrated import open_camera as open_camera
    from camctl.records.capture_plan import CapturePlan as CapturePlan
    from camctl.records.folder_store import read_report as read_report
    from camctl.records.frame import FrameRecord as FrameRecord
    from camctl.records.report import Achieved as Achieved
    from camctl.records.report import CaptureReport as CaptureReport
    from camctl.records.report import Irradiance as Irradiance

#: Where each public name is defined: the names of one module of camctl in a line.
_NAMES = {
    "interface.backends": (
        "BackendListing BackendOptions CameraBackend FrameShape list_backends list_cameras"
    ),
    "interface.camera": (
        "Camera CameraBase CameraInfo Frame FrameStream OriginalFile PreviewingCamera "
        "StreamingCamera"
    ),
    "records.folder_store": "read_report",
    "captures.plan": "plan_capture",
    "records.frame": "FrameRecord",
    "evidence.ratio_check": "RatioCheck",
    "records.report": "Achieved CaptureReport Irradiance",
    "records.capture_plan": "CapturePlan",
    "exposure.goal": "CaptureRequest",
    "exposure.light": "Metering",
    "captures.sequence": "Progress",
    "captures.sequencer": "capture resume",
    "interface.clock": "CaptureTiming Clock RealClock VirtualClock",
    "interface.controls": "Choices ExposureControls ExposureSetting Layout ResponseOrigin Steps",
    "interface.cycle": "CyclingCamera FrameCycle",
    "livestream.result": "LiveResult",
    "livestream.stream": "Live live",
    "livestream.video_capture": "VideoCapture",
    "errors": (
        "CamctlError CameraBusyError CameraClosedError CameraDisconnectedError CameraError "
        "CameraNotFoundError CameraProtocolError CameraTimeoutError CaptureError DataError "
        "InterruptedCaptureError OutOfMemoryError RefusedSettingError ResourceError StorageError "
        "UnreachableExposureError UsageError"
    ),
    "exposure.accuracy": "AccuracySolution solve_accuracy",
    "exposure.evaluation": "Evaluation evaluate",
    "exposure.exposure_choices": "AccuracyProblem AvailableExposures TimeCosts",
    "exposure.objective": "Objective",
    "exposure.solver": "SearchOptions Solution solve",
    "exposure.table": "ExposureTable",
    "photographs.merge": "merge",
    "photographs.photograph_set": "PhotographOptions",
    "pictures.combine": "Combination combine",
    "profiles.calibrated": "open_camera",
    "model.noise": "FrameNoise NoiseModel",
    "model.response.camera": "CameraResponse linear_response standard_response",
    "model.response.desired": "DesiredResponse desired_response",
    "model.response.measured": "measured_response",
    "model.response.tabulated": "tabulated_desired",
}
_MODULES = {name: f"camctl.{module}" for module, names in _NAMES.items() for name in names.split()}

#: Public modules.
_SUBMODULES = ("calibrate",)

__all__ = ["__version__", *_SUBMODULES, *_MODULES]

if not TYPE_CHECKING:  # a type checker would take every name for one that exists

    def __getattr__(name: str) -> object:
        """Import the module that defines a public name, and return what it names (PEP 562)."""
        from importlib import import_module

        if name in _SUBMODULES:
            return import_module(f"camctl.{name}")
        if name not in _MODULES:
            raise AttributeError(f"module 'camctl' has no attribute '{name}'")
        value = globals()[name] = getattr(import_module(_MODULES[name]), name)
        return value


def __dir__() -> list[str]:
    return sorted(__all__)
