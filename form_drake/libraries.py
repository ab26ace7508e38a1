"""Libraries and modules that are missing, and the packages that have them."""

import re

DEBIAN = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libglib-2.0.so.0": "libglib2.0-bin",
    "libidn2.so.0": "libidn2-0",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
# Modules whose package on PyPI has another name.
PYPI = {
    "cv2": "opencv-python-headless",
    "pydrake": "drake",
    "warp": "warp-lang",
    "yaml": "pyyaml",
}


def explained(error: ImportError | OSError) -> str:
    """One line for a library or module that could not be loaded; other errors as they are."""
    text = " ".join(str(error).split())
    found = re.search(r"(\S+\.so[.\d]*): cannot open shared object file", text)
    if found:
        library = found[1].rsplit("/", 1)[-1]
        package = DEBIAN.get(library)
        remedy = f"install the Debian package {package}" if package else "install the package of it"
        command = f": sudo apt-get install {package}" if package else ""
        return f"the system library {library} is missing; {remedy}{command}"
    if isinstance(error, ModuleNotFoundError) and error.name:
        module = error.name.partition(".")[0]
        name = PYPI.get(module, module)
        return f"the Python package {name} is missing; reinstall form-drake with its dependencies"
    return text
