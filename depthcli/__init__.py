"""depthcli: batch stereo matching, depth refinement, fusion, confidence and their evaluation.

The functions and classes for Python stand in ``__init__.pyi``, with their modules, which are imported on first use.
"""

from importlib import import_module

__version__ = "0.2.0"

_MODULES = {
    "api.inputs": ("load_config",),
    "api.depth": ("complete_transparent", "refine_depth"),
    "api.maps": ("MapConfidence", "fuse_maps", "map_confidence"),
    "api.registration": ("RegistrationConfidence", "registration_confidence"),
    "api.results": ("Depth", "Disparity", "PointCloud", "RefinedDepth"),
    "api.scores": ("Scores", "evaluate"),
    "api.stereo": ("Matcher", "fuse", "matcher", "stereo"),
    "core.errors": ("ConfigError", "DepthcliError", "InputError", "OutputError"),
    "core.maps": ("DepthStatus", "Status"),
    "methods.fusion.config": ("FuseConfig",),
    "methods.kinect.config": ("RefineKinectConfig",),
    "methods.registration.config": ("RegisterConfidenceConfig",),
    "methods.stereo.config": ("StereoConfig",),
    "methods.transparent.config": ("TransparentConfig",),
}
_PLACES = {name: module for module, names in _MODULES.items() for name in names}
__all__ = ["__version__", *_PLACES]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module 'depthcli' has no attribute {name!r}")
    value = getattr(import_module(f"depthcli.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
