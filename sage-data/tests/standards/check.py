"""Runs ASAM's checkers on all scenarios and maps of a folder. Exit status 1 if there is an issue.

    pip install asam-qc-openscenarioxml asam-qc-opendrive "lxml<6"
    python check.py [--schema-only] FOLDER_OR_FILE...

The maps must lie beside the scenarios that name them: without its map, a scenario's signals are not checked.
With --schema-only, the files are validated against the XML schemas inside the packages, which is faster.
"""

import collections
import pathlib
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree

# Ending of a file, the program that checks it, and the name of the program's list of checkers.
PROGRAMS = {".xosc": ("qc_openscenario", "xoscBundle"), ".xodr": ("qc_opendrive", "xodrBundle")}
CONFIGURATION = """<Config>
  <Param name="InputFile" value="{file}"/>
  <CheckerBundle application="{bundle}"><Param name="resultFile" value="{result}"/></CheckerBundle>
</Config>"""


def checked(file):
    """Issues of a file, and how many checkers ended with which status."""
    program, bundle = PROGRAMS[file.suffix]
    with tempfile.TemporaryDirectory() as scratch:
        configuration, result = pathlib.Path(scratch, "config.xml"), pathlib.Path(scratch, "result.xqar")
        configuration.write_text(CONFIGURATION.format(file=file.resolve(), bundle=bundle, result=result))
        command = [pathlib.Path(sys.executable).with_name(program), "-c", configuration]
        run = subprocess.run(command, cwd=scratch, capture_output=True, text=True)
        # The exit status of the program does not depend on what it finds.
        if not result.exists():
            return [f"{program} gave no result: {run.stderr[-400:]}"], collections.Counter()
        checkers = list(ElementTree.parse(result).getroot().iter("Checker"))
    issues = []
    for checker in checkers:
        name = checker.get("checkerId")
        issues += [f"{name}: {issue.get('description')}" for issue in checker.iter("Issue")]
    statuses = collections.Counter(checker.get("status") for checker in checkers)
    if not statuses["completed"] or statuses["error"]:
        issues.append(f"checkers did not run: {dict(statuses)}")
    return issues, statuses


def schemas():
    """A function that gives the errors of a file against its schema."""
    import qc_opendrive
    import qc_openscenario
    from lxml import etree

    packages = {".xosc": qc_openscenario, ".xodr": qc_opendrive}
    known = {}

    def validate(file):
        document = etree.parse(file)
        header = document.find("FileHeader" if file.suffix == ".xosc" else "header")
        version = f"{header.get('revMajor')}.{header.get('revMinor')}"
        name = f"{version}.0/OpenSCENARIO.xsd" if file.suffix == ".xosc" else "1.7.0/opendrive_17_core.xsd"
        if name not in known:
            folder = pathlib.Path(packages[file.suffix].__file__).parent
            known[name] = etree.XMLSchema(etree.parse(folder / "schema" / name))
        known[name].validate(document)
        errors = [f"line {error.line}: {error.message}" for error in known[name].error_log]
        return errors, collections.Counter([name])

    return validate


def main(arguments):
    check = schemas() if "--schema-only" in arguments else checked
    files = []
    for argument in (pathlib.Path(argument) for argument in arguments if not argument.startswith("--")):
        files += sorted(argument.iterdir()) if argument.is_dir() else [argument]
    files = [file for file in files if file.suffix in PROGRAMS]
    total, counts = collections.Counter(), 0
    for file in files:
        issues, statuses = check(file)
        total.update(statuses)
        counts += len(issues)
        for issue in issues[:20]:
            print(f"{file.name}: {issue}")
    print(f"{len(files)} files, {counts} issues, {dict(total)}", flush=True)
    return 1 if counts or not files else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
