"""A controller at work: guards, safe stop, the compiled step, and the controller as C.

Reading order: `guards` (settings) -> `safety` (checks and stop, sample by sample) ->
`compiled_step` -> `running`; for C, `c_text` and the templates in ``c/`` -> `c_running` (with
guards), `c_export` (the law alone).
"""

from plant.realtime.c_export import write_c
from plant.realtime.c_running import names_of, values_of
from plant.realtime.c_text import (
    CONTROLLER,
    Output,
    require_counts,
    require_exportable,
    require_folder,
    rig_of,
    write_templates,
)
from plant.realtime.guards import Guards, limited
from plant.realtime.memory import Layout
from plant.realtime.running import Running

__all__ = [
    "CONTROLLER",
    "Guards",
    "Layout",
    "Output",
    "Running",
    "limited",
    "names_of",
    "require_counts",
    "require_exportable",
    "require_folder",
    "rig_of",
    "values_of",
    "write_c",
    "write_templates",
]
