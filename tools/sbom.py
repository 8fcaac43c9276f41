"""What the program is made of, from the lock file: a CycloneDX 1.5 list, `python -m tools.sbom`.

Every package of requirements.lock with its version, hashes and condition; licences where the package is
installed here. The same lock gives the same bytes: no time, no random number.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import uuid
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from smoother import __version__

ROOT = Path(__file__).parents[1]
_PINNED = re.compile(r"^([A-Za-z0-9._-]+)(?:\[[^\]]*\])?==([^\s;\\]+)\s*(?:;\s*([^\\]*?))?\s*\\?$")
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")


@dataclass
class Package:
    """A package of the lock.

    Attributes
    ----------
    name, version : str
        As the lock has them.
    condition : str
        Where it is installed (Python, system); "" = everywhere.
    hashes : list of str
        SHA-256 of its files.
    """

    name: str
    version: str
    condition: str = ""
    hashes: list[str] = field(default_factory=list)

    @property
    def purl(self) -> str:
        """Its package URL."""
        return f"pkg:pypi/{re.sub(r'[-_.]+', '-', self.name).lower()}@{self.version}"


def locked(text: str) -> list[Package]:
    """The packages of a lock file.

    Raises
    ------
    ValueError
        A line is neither a pinned package nor a hash.
    """
    packages: list[Package] = []
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        if found := _HASH.search(line):
            packages[-1].hashes.append(found[1])
        elif pinned := _PINNED.match(line.strip()):
            packages.append(Package(pinned[1], pinned[2], (pinned[3] or "").strip()))
        else:
            raise ValueError(f"not understood: {line}")
    return packages


def sbom(packages: list[Package], version: str) -> dict[str, Any]:
    """The list as CycloneDX has it."""
    components = [component(package) for package in packages]
    root = f"pkg:pypi/unocclude@{version}"
    serial = uuid.uuid5(uuid.NAMESPACE_URL, root + "".join(sorted(package.purl for package in packages)))
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "serialNumber": f"urn:uuid:{serial}",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": "unocclude",
                "version": version,
                "purl": root,
                "licenses": [{"license": {"id": "Apache-2.0"}}],
            }
        },
        "components": components,
        "dependencies": [{"ref": root, "dependsOn": [each["bom-ref"] for each in components]}],
    }


def component(package: Package) -> dict[str, Any]:
    """One package."""
    entry: dict[str, Any] = {
        "type": "library",
        "bom-ref": package.purl,
        "name": package.name,
        "version": package.version,
        "purl": package.purl,
        "externalReferences": [
            {
                "type": "distribution",
                "url": f"https://pypi.org/project/{package.name}/{package.version}/",
                "hashes": [{"alg": "SHA-256", "content": each} for each in sorted(package.hashes)],
            }
        ],
    }
    if licence := licence_of(package):
        entry["licenses"] = [{"license": {"name": licence}}]
    if package.condition:
        entry["properties"] = [{"name": "unocclude:condition", "value": package.condition}]
    return entry


def licence_of(package: Package) -> str:
    """The licence stated by the installed package; "" where another version or none is installed."""
    try:
        about = metadata.metadata(package.name)
    except metadata.PackageNotFoundError:
        return ""
    if about["Version"] != package.version:
        return ""
    classified = [
        line.rpartition("::")[2].strip()
        for line in about.get_all("Classifier") or []
        if line.startswith("License ::")
    ]
    stated = about.get("License-Expression") or ", ".join(classified) or about.get("License") or ""
    return stated.strip().splitlines()[0][:120] if stated.strip() else ""


def main() -> None:
    """Write the list."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    packages = locked((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    text = json.dumps(sbom(packages, __version__), indent=1) + "\n"
    if options.output is None:
        sys.stdout.write(text)
        return
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(text, encoding="utf-8")
    print(f"{options.output}: {len(packages)} packages")


if __name__ == "__main__":
    main()
