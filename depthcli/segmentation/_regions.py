"""Former name of :mod:`depthcli.labelling.regions`."""

from depthcli.labelling.regions import *  # noqa: F403
from depthcli.labelling.regions import consecutive as _consecutive  # noqa: F401
from depthcli.labelling.regions import root as _root  # noqa: F401
