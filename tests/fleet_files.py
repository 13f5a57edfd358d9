"""What the files in deploy/ say: resources of Kubernetes, and keys of systemd's units."""

import re
from pathlib import Path

import yaml

from ogm_services.settings.sources import load_settings

KUBERNETES = Path(__file__).parents[1] / "deploy/kubernetes"


def resources():
    """All resources of the kustomize base."""
    listed = yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text())["resources"]
    return [part for name in listed for part in yaml.safe_load_all((KUBERNETES / name).read_text()) if part]


def one(kind, name):
    """The one resource of that kind and name."""
    (found,) = [each for each in resources() if (each["kind"], each["metadata"]["name"]) == (kind, name)]
    return found


def containers(resource):
    """Containers of the pods that a resource makes, those that come first last."""
    pod = resource["spec"].get("template", {}).get("spec", {}) if "spec" in resource else {}
    return [*pod.get("containers", ()), *pod.get("initContainers", ())]


def environment(container, index=None):
    """Variables of a container's own; `index` takes the place of the pod's label."""
    found = {}
    for each in container["env"]:
        if "value" in each:
            found[each["name"]] = each["value"]
        elif "fieldRef" in each["valueFrom"]:
            found[each["name"]] = index
        else:
            assert each["valueFrom"]["secretKeyRef"]["optional"] is True
            found[each["name"]] = "0f" * 24
    return found


def settings_of(kind, name, folder, index=None):
    """Settings of the pod `index` of a resource, as read there; their file goes into `folder`."""
    (container,) = one(kind, name)["spec"]["template"]["spec"]["containers"]
    path = folder / "settings.yaml"
    path.write_text(one("ConfigMap", "settings")["data"]["settings.yaml"])
    return load_settings(config=path, flags={}, environ=environment(container, index))


def unit_keys(path):
    """Values of every key of a unit's section [Service], in order."""
    found, section = {}, None
    for line in path.read_text().splitlines():
        if match := re.fullmatch(r"\[(\w+)\]", line):
            section = match[1]
        elif section == "Service" and line and not line.startswith("#"):
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found
