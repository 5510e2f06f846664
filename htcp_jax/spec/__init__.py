"""Jobs, cells, tools, kinds of obstacles and of task rows as people write them: data only.

Neither JAX nor MuJoCo is loaded.

`PlanConfig` is a job; `config` has its sections, and `config_file` merges base files and overrides. `examples` are the
jobs that ship with the package. `choices` has choices and defaults that readers of files share. `strict_yaml` and
`strict_model` read YAML and refuse what a model does not have. `ModelSource` names the models that form a robot, `Tool`
is a mounted tool, and `feed` parses feed rates.

`PointRow`, `AxisRow`, `OrientationRow` (`task_list`) and `ToolAxisRow` (`tool_angles`) are the rows of a task;
`TaskRowKind` is their base class, and that of rows of other packages. `ObstacleKind` is the base class of other
packages' obstacles. `Registry` finds both by name, `kinds` splits their instances into numbers and templates, and
`given_kinds` reads them from a job.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
