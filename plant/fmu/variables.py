"""What an FMU exchanges, by name, and its model description in both versions of FMI."""

import dataclasses
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

from plant.version import __version__

_UNITS = {"rad": {"rad": "1"}, "rad/s": {"rad": "1", "s": "-1"}, "rad/s2": {"rad": "1", "s": "-2"},
          "N.m": {"kg": "1", "m": "2", "s": "-2"}, "s": {"s": "1"}}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Variable:
    """One number: an input, output or parameter, real or whole; outputs have no start."""

    name: str
    causality: str
    said: str
    unit: str | None = None
    start: float = 0.0
    whole: bool = False

    @property
    def settable(self) -> bool:
        return self.causality != "output"


def of_joints(quantity: str, joints: Sequence[str], causality: str, said: str, **options: object) -> list[Variable]:
    """One variable per joint, ``torque.elbow``."""
    return [Variable(f"{quantity}.{joint}", causality, f"{said}, {joint}", **options) for joint in joints]  # type: ignore[arg-type]


def named_joints(labels: Iterable[str]) -> list[str]:
    """Names of joints as FMI has them in ``torque.elbow``, from their labels."""
    names = [re.sub(r"[^A-Za-z0-9]+", "_", re.sub(r"(?<=\S) \(q\[\d+\]\)$", "", label)).strip("_") for label in labels]
    if len(set(names)) < len(names) or not all(re.match("[A-Za-z]", name) for name in names):
        rule = "differ in letters and digits, and begin with a letter"
        raise ValueError(f"joint names must {rule}; got {', '.join(names)}. Rename the joints of chain or drive.")
    return names


def model_description(
    version: int, name: str, token: str, said: str, step: float, variables: Sequence[Variable], files: Sequence[str]
) -> bytes:
    """The file modelDescription.xml; a variable's value reference is its place, in `variables` the reals come first."""
    second = version == 2
    root = ET.Element(
        "fmiModelDescription", fmiVersion=f"{version}.0", modelName=name, description=said,
        generationTool=f"onepulse {__version__}", variableNamingConvention="structured",
    )  # fmt: skip
    root.set("guid" if second else "instantiationToken", token)
    state = "state" if second else "State"
    able = {"modelIdentifier": name, f"canGetAndSetFMU{state}": "true", f"canSerializeFMU{state}": "true"}
    kind = ET.SubElement(root, "CoSimulation", able if second else {**able, "fixedInternalStepSize": repr(step)})
    if second:
        listed = ET.SubElement(kind, "SourceFiles")
        for file in files:
            ET.SubElement(listed, "File", name=file)
    units = ET.SubElement(root, "UnitDefinitions")
    for unit, base in _UNITS.items():
        ET.SubElement(ET.SubElement(units, "Unit", name=unit), "BaseUnit", base)
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=repr(step))
    listed = ET.SubElement(root, "ModelVariables")
    for place, variable in enumerate(variables):
        _declare(listed, variable, place, second)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [place for place, variable in enumerate(variables) if not variable.settable]
    if second:
        for group in ("Outputs", "InitialUnknowns"):
            of = ET.SubElement(structure, group)
            for place in outputs:
                ET.SubElement(of, "Unknown", index=str(place + 1))
    else:
        ET.SubElement(listed, "Float64", name="time", valueReference=str(len(variables)), causality="independent",
                      variability="continuous", unit="s")  # fmt: skip
        for group in ("Output", "InitialUnknown"):
            for place in outputs:
                ET.SubElement(structure, group, valueReference=str(place))
    return _text(root)


def build_description(name: str, files: Sequence[str]) -> bytes:
    """The file buildDescription.xml of FMI 3's sources."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    listed = ET.SubElement(build, "SourceFileSet", language="C99", compilerOptions="-ffp-contract=off")
    for file in files:
        ET.SubElement(listed, "SourceFile", name=file)
    return _text(root)


def _declare(listed: ET.Element, variable: Variable, place: int, second: bool) -> None:
    """One variable of ModelVariables."""
    about = {"name": variable.name, "valueReference": str(place), "description": variable.said,
             "causality": variable.causality}  # fmt: skip
    if variable.causality == "parameter":
        about["variability"] = "fixed"
    elif variable.whole:
        about["variability"] = "discrete"
    if not variable.settable:
        about["initial"] = "calculated"
    value = {} if variable.unit is None else {"unit": variable.unit}
    if variable.settable:
        value["start"] = str(int(variable.start)) if variable.whole else repr(float(variable.start))
    if second:
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", about), "Integer" if variable.whole else "Real", value)
    else:
        ET.SubElement(listed, "Int32" if variable.whole else "Float64", about | value)


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text
