from depthcli.api.config import load_config as load_config
from depthcli.api.depth import complete_transparent as complete_transparent
from depthcli.api.depth import refine_depth as refine_depth
from depthcli.api.points import PointCloud as PointCloud
from depthcli.api.registration import RegistrationConfidence as RegistrationConfidence
from depthcli.api.registration import registration_confidence as registration_confidence
from depthcli.api.results import Depth as Depth
from depthcli.api.results import Disparity as Disparity
from depthcli.api.results import RefinedDepth as RefinedDepth
from depthcli.api.scores import Scores as Scores
from depthcli.api.scores import evaluate as evaluate
from depthcli.api.stereo import Matcher as Matcher
from depthcli.api.stereo import fuse as fuse
from depthcli.api.stereo import matcher as matcher
from depthcli.api.stereo import stereo as stereo
from depthcli.core.errors import ConfigError as ConfigError
from depthcli.core.errors import DepthcliError as DepthcliError
from depthcli.core.errors import InputError as InputError
from depthcli.core.errors import OutputError as OutputError
from depthcli.core.maps import DepthStatus as DepthStatus
from depthcli.core.maps import Status as Status
from depthcli.methods.fusion.config import FuseConfig as FuseConfig
from depthcli.methods.kinect.config import RefineKinectConfig as RefineKinectConfig
from depthcli.methods.registration.config import RegisterConfidenceConfig as RegisterConfidenceConfig
from depthcli.methods.stereo.config import StereoConfig as StereoConfig
from depthcli.methods.transparent.config import TransparentConfig as TransparentConfig

__version__: str
