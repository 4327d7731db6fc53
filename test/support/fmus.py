"""FMUs for tests: a model's own, changed in its description; and one of another kind, written in C here."""

import subprocess
import zipfile
from functools import cache

from samplings import make_sampling

from ces_identify.export.export_model import binary_path, export_fmu
from ces_observer.model import Envelope, Model
from ces_observer.proof.certificate import Contraction
from ces_observer.structures.polynomial import Factor, Polynomial, Term

UNPROVED = Contraction(2.0, 1.0, 1, "", "")
SPEED, CURRENT = Factor("speed", 0), Factor("current", 0)

# F = damping * speed * (1 + current) + stiffness * position, at once: what it answers shows when inputs arrive.
ALGEBRAIC = """
#include <stdlib.h>
#include <string.h>
static double in[3], out; static int alive;
void *fmi2Instantiate(const char *n, int type, const char *guid, const char *r, const void *c, int v, int l)
{ alive++; memset(in, 0, sizeof in); return strcmp(guid, "{algebraic}") ? 0 : &alive; }
void fmi2FreeInstance(void *c) { }
int fmi2SetReal(void *c, const unsigned *vr, size_t n, const double *v)
{ for (size_t i = 0; i < n; i++) in[vr[i]] = v[i]; return 0; }
int fmi2GetReal(void *c, const unsigned *vr, size_t n, double *v) { v[0] = out; return vr[0] == 3 ? 0 : 3; }
int fmi2DoStep(void *c, double t, double h, int x)
{ out = 1500.0 * in[1] * (1.0 + in[2]) + 20.0 * in[0]; return t > 1.9 && in[2] > 7.0 ? 3 : 0; }
int fmi2ExitInitializationMode(void *c) { return fmi2DoStep(c, 0.0, 1.0, 1); }
#define OK(name) int name(void) { return 0; }
OK(fmi2SetupExperiment) OK(fmi2EnterInitializationMode) OK(fmi2Terminate) OK(fmi2Reset) OK(fmi2SetDebugLogging)
OK(fmi2GetInteger) OK(fmi2GetBoolean) OK(fmi2GetString) OK(fmi2SetInteger) OK(fmi2SetBoolean) OK(fmi2SetString)
OK(fmi2GetFMUstate) OK(fmi2SetFMUstate) OK(fmi2FreeFMUstate) OK(fmi2SerializedFMUstateSize) OK(fmi2SerializeFMUstate)
OK(fmi2DeSerializeFMUstate) OK(fmi2GetDirectionalDerivative) OK(fmi2SetRealInputDerivatives) OK(fmi2CancelStep)
OK(fmi2GetRealOutputDerivatives) OK(fmi2GetStatus) OK(fmi2GetRealStatus) OK(fmi2GetIntegerStatus)
OK(fmi2GetBooleanStatus) OK(fmi2GetStringStatus)
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
"""
ALGEBRAIC_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="algebraic" guid="{algebraic}">
  <CoSimulation modelIdentifier="algebraic" canHandleVariableCommunicationStepSize="VARIABLE"/>
  <UnitDefinitions>
    <Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit><Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
    <Unit name="kN"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit>
  </UnitDefinitions>
  <DefaultExperiment stepSize="0.0005"/>
  <ModelVariables>
    <ScalarVariable name="rear.x" valueReference="0" causality="input"><Real unit="mm" start="0"/></ScalarVariable>
    <ScalarVariable name="rear.v" valueReference="1" causality="input"><Real unit="m/s" start="0"/></ScalarVariable>
    <ScalarVariable name="rear.i" valueReference="2" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="rear.out" valueReference="3" causality="output"><Real unit="kN"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="4"/></Outputs></ModelStructure>
</fmiModelDescription>
"""


def damper(past=0.6, **sampling):
    """Return a small model of 1 kHz."""
    settings = {"outlier_m": 0.004, "warm_up_s": 0.1, **sampling}
    envelope = Envelope((-0.018, 0.018), (-1.5, 1.4), (0.1, 0.9))
    terms = (Term(past, (Factor("force", 1),)), Term(900.0, (SPEED,)), Term(400.0, (SPEED, CURRENT)), Term(-5.0, ()))
    return Model(make_sampling(**settings), Polynomial(terms), envelope, (-9e3, 8e3))


def damper_fmu(folder, **changes):
    """Write damper.fmu with texts of its description changed; return its path."""
    path = folder / "damper.fmu"
    path.write_bytes(_exported())
    return changed(path, changes) if changes else path


@cache
def _exported():
    return export_fmu(damper(), "damper", UNPROVED, ["cc"])


def changed(path, changes, without=()):
    """Change texts of an FMU's description, and leave out what is in a folder named."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist() if not name.startswith(tuple(without) or "\0")}
    text = files["modelDescription.xml"].decode()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    files["modelDescription.xml"] = text.encode()
    return packed(path, files)


def packed(path, files):
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def algebraic_fmu(folder, variable="true", changes=None):
    """Write algebraic.fmu: position in mm, speed, a current without a unit; force in kN; no interpolation.

    `changes` are of texts of its source.
    """
    source = ALGEBRAIC
    for old, new in (changes or {}).items():
        assert old in source
        source = source.replace(old, new)
    (folder / "algebraic.c").write_text(source)
    subprocess.run(["cc", "-fPIC", "-shared", "-w", "-o", "algebraic.so", "algebraic.c"], cwd=folder, check=True)
    library = (folder / "algebraic.so").read_bytes()
    xml = ALGEBRAIC_XML.replace("VARIABLE", variable)
    return packed(folder / "algebraic.fmu", {"modelDescription.xml": xml, binary_path("algebraic"): library})
