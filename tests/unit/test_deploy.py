"""The image and the compose file: valid, closed to the outside, pinned."""

import re
import tomllib

import pytest
import yaml
from documents import DOCUMENTS, blocks
from extras import locked
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from paths import ROOT

COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES: dict[str, dict] = COMPOSE["services"]
DOCKERFILE = (ROOT / "Dockerfile").read_text().replace("\\\n", "")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCK = (ROOT / "requirements.lock").read_text()


def instructions(name: str) -> list[str]:
    """The arguments of each instruction `name` of the Dockerfile."""
    return re.findall(rf"^\s*{name}\s+(.*)$", DOCKERFILE, re.MULTILINE)


def test_topology_is_a_scheduler_two_workers_and_the_service_that_the_image_runs():
    assert set(SERVICES) == {"scheduler", "worker", "service"}
    assert SERVICES["worker"]["deploy"]["replicas"] == 2
    (command,) = re.findall(r"^CMD (.*)$", DOCKERFILE, re.MULTILINE)
    assert SERVICES["service"]["command"] == [*yaml.safe_load(command), "--scheduler", "tcp://scheduler:8786"]
    assert int(instructions("USER")[-1]) > 0


def test_scheduler_has_the_settings_that_the_service_needs():
    from worker.executors.clusters import SCHEDULER_SETTINGS, environment_variable

    environment = SERVICES["scheduler"]["environment"]
    assert {name: float(value) for name, value in environment.items()} == {
        environment_variable(name): value for name, value in SCHEDULER_SETTINGS.items()
    }
    document = (ROOT / "docs" / "deployment.md").read_text()
    assert all(f"{name}={value}" in document for name, value in environment.items())


@pytest.mark.parametrize("name", SERVICES)
def test_container_restarts_is_checked_limited_and_read_only(name: str):
    container = SERVICES[name]
    assert container["restart"] == "unless-stopped"
    # A line for a shell: podman-compose 1.0 fails at lists.
    assert re.fullmatch(r"""python -c "from urllib[^"$`\\]*\"""", container["healthcheck"]["test"])
    assert container["mem_limit"]
    assert container["cap_drop"] == ["ALL"]
    assert container["read_only"] is True
    assert container["tmpfs"] == ["/tmp"]
    (volumes,) = instructions("VOLUME")  # what else is written lies in them
    mounted = {volume.rpartition(":")[2] for volume in container.get("volumes", [])}
    assert mounted in (set(), set(yaml.safe_load(volumes)))


def test_only_the_services_port_is_published_and_only_on_loopback():
    assert [name for name in SERVICES if "ports" in SERVICES[name]] == ["service"]
    assert SERVICES["service"]["ports"] == ["${BOUNCE_PUBLISH:-127.0.0.1:8000}:8000"]
    assert not any(container.get("network_mode") for container in SERVICES.values())
    assert COMPOSE["networks"]["cluster"]["internal"] is True
    assert SERVICES["scheduler"]["networks"] == SERVICES["worker"]["networks"] == ["cluster"]


def test_health_pages_of_dask_listen_inside_their_containers_only():
    for name in ("scheduler", "worker"):
        command = SERVICES[name]["command"]
        assert "--no-dashboard" in command
        assert command[command.index("--dashboard-address") + 1].startswith("127.0.0.1:")


def dask_commands() -> list[str]:
    """The commands of all documents that start a scheduler or workers, with the variables that they name."""
    found = []
    for document in DOCUMENTS:
        for block in blocks(document):
            if block.language != "sh":
                continue
            code = block.code.replace("\\\n", " ")
            variables = dict(re.findall(r'^(\w+)="(.*)"', code, re.MULTILINE))
            for command in re.findall(r"^dask (?:scheduler|worker) [^&\n]*", code, re.MULTILINE):
                found.append(re.sub(r"\$(\w+)", lambda name, of=variables: of[name[1]], command))
    return found


def test_no_command_of_the_documents_listens_beyond_loopback_without_tls():
    commands = dask_commands()
    assert len(commands) >= 5
    for command in commands:
        beyond = "--host 127.0.0.1" not in command
        assert not beyond or "--protocol tls" in command, command
        assert not beyond or all(f"--tls-{part} " in command for part in ("ca-file", "cert", "key")), command
        assert "--no-dashboard" in command, command
        assert "--dashboard-address 127.0.0.1:0" in command, command


def test_clusters_of_the_documents_are_closed():
    """Those that functions make: on loopback, with a password, or over TLS."""
    made = {block.file: block.code for block in blocks("docs/deployment.md") if "def cluster()" in block.code}
    assert set(made) == {"batch_queue.py", "gateway.py", "local_gateway.py", "elastic.py"}
    for code in (made["batch_queue.py"], made["elastic.py"]):
        assert re.search(r"""["']?dashboard_address["']?(=|: )"127\.0\.0\.1:0\"""", code)
    assert 'host="127.0.0.1"' in made["elastic.py"]
    assert "security=True" in made["batch_queue.py"]
    assert '"--dashboard-address", "127.0.0.1:0"' in made["batch_queue.py"]
    assert 'Gateway("https://' in made["gateway.py"]
    assert 'Gateway("http://127.0.0.1:' in made["local_gateway.py"]
    (gateway,) = (block.code for block in blocks("docs/deployment.md") if "c.Proxy.address" in block.code)
    assert 'c.Proxy.address = "127.0.0.1:' in gateway
    assert "c.SimpleAuthenticator.password = os.environ[" in gateway


def test_pods_speak_tls_and_are_reached_by_each_other_only():
    from worker.executors.clusters import SCHEDULER_SETTINGS, environment_variable

    things = list(yaml.safe_load_all((ROOT / "docs" / "kubernetes.yaml").read_text()))
    (cluster,) = (thing["spec"] for thing in things if thing["kind"] == "DaskCluster")
    (service,) = (thing["spec"]["template"]["spec"] for thing in things if thing["kind"] == "Deployment")
    pods = {part: cluster[part]["spec"] for part in ("scheduler", "worker")} | {"service": service}
    containers = {part: pod["containers"][0] for part, pod in pods.items()}
    for part in ("scheduler", "worker"):
        words = containers[part]["args"]
        assert all(f"--tls-{file}" in words for file in ("ca-file", "cert", "key"))
        assert "--no-dashboard" in words
    address = "tls://bounce-scheduler:8786"
    assert containers["scheduler"]["args"][2:4] == ["--protocol", "tls"]
    assert address in containers["worker"]["args"]
    assert containers["service"]["args"][-2:] == ["--scheduler", address]
    variables = {variable["name"] for variable in containers["service"]["env"]}
    assert {
        "BOUNCE_TOKEN",
        "BOUNCE_SCHEDULER_CA",
        "BOUNCE_SCHEDULER_CERT",
        "BOUNCE_SCHEDULER_KEY",
    } < variables
    settings = {variable["name"]: float(variable["value"]) for variable in containers["scheduler"]["env"]}
    assert settings == {environment_variable(name): value for name, value in SCHEDULER_SETTINGS.items()}
    stores = {"name": "stores", "mountPath": "/stores"}
    assert all(stores in containers[part]["volumeMounts"] for part in ("worker", "service"))
    for part, pod in pods.items():
        assert pod["enableServiceLinks"] is False  # of the service "bounce": BOUNCE_PORT
        assert pod["securityContext"]["runAsUser"] == int(instructions("USER")[-1])
        assert containers[part]["securityContext"]["readOnlyRootFilesystem"] is True
        # an emptyDir is open to every user: as the cache of kernels it would be refused
        assert all(mount["mountPath"] != "/app/numba-cache" for mount in containers[part]["volumeMounts"])
    services = [cluster["scheduler"]["service"], *(t["spec"] for t in things if t["kind"] == "Service")]
    assert {each["type"] for each in services} == {"ClusterIP"}
    closed = [t["spec"]["podSelector"]["matchLabels"]["app"] for t in things if t["kind"] == "NetworkPolicy"]
    assert closed == ["bounce-scheduler", "bounce-worker"]


def test_workers_and_service_share_the_data_folder_and_nothing_else():
    cache = re.search(r"NUMBA_CACHE_DIR=(\S+)", DOCKERFILE)
    assert cache
    own = cache[1]  # a volume without a name: each container has another
    assert SERVICES["worker"]["volumes"] == SERVICES["service"]["volumes"] == ["data:/data", own]
    assert "volumes" not in SERVICES["scheduler"]
    assert not own.startswith("/data")


def test_build_context_holds_what_the_image_copies():
    sources = {word for line in instructions("COPY") for word in line.split()[:-1]}
    assert all((ROOT / source).exists() for source in sources)
    in_build_context = {
        line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")
    }
    assert sources == in_build_context
    assert set(PROJECT["project"]["license-files"]) < sources


def test_lock_has_every_library_at_a_version_the_project_takes():
    project, pins = PROJECT["project"], locked()
    build = PROJECT["dependency-groups"]["build"]
    for text in (*project["dependencies"], *project["optional-dependencies"]["s3"], *build):
        requirement = Requirement(text)
        locked_pins = pins.get(canonicalize_name(requirement.name), [])
        assert locked_pins, f"{requirement} is not in requirements.lock: renew it (CONTRIBUTING.md)"
        for pin in locked_pins:
            (version,) = pin.specifier
            assert requirement.specifier.contains(version.version), (
                f"{pin} in requirements.lock, {requirement} in pyproject"
            )


def test_lock_covers_the_images_python_and_is_hashed():
    (python,) = re.findall(r"^FROM python:(\d+\.\d+)", DOCKERFILE, re.MULTILINE)
    environment = {"python_full_version": f"{python}.0", "python_version": python, "sys_platform": "linux"}
    for name, pins in locked().items():
        applicable = [pin for pin in pins if not pin.marker or pin.marker.evaluate(environment)]
        assert len(applicable) <= 1, name
    assert len(re.findall(r"==\S+[^\n]*\\\n    --hash=sha256:", LOCK)) == sum(map(len, locked().values()))
    assert "://" not in LOCK
