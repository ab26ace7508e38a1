"""Materials as files: what is written comes back, what is wrong is refused."""

from dataclasses import replace

import numpy as np
import pytest

from form_drake import LAWS, Material, read_material
from helpers.files import refused


def sample_material():
    covariance = np.array([[4.0, -1.0], [-1.0, 9.0]])
    return Material(
        LAWS["von-mises"],
        {"mu": 1234.5, "lam": 6789.0, "tau_y": 55.5},
        1000.0,
        ("mu", "lam"),
        covariance,
    )


def test_materials_come_back_as_written(tmp_path):
    material = sample_material()
    material.write(tmp_path / "a.yaml")
    again = read_material(tmp_path / "a.yaml")
    assert again.law is material.law
    assert (again.values, again.density, again.keys) == (
        material.values,
        material.density,
        material.keys,
    )
    np.testing.assert_array_equal(again.covariance, material.covariance)


HEAD = "form_drake_material: 1\nlaw: fixed-corotated\n"


def material_file(folder, text):
    (folder / "a.yaml").write_text(text)
    return folder / "a.yaml"


def test_engineering_constants_stand_for_lame_constants(tmp_path):
    text = HEAD + "parameters: {E: {value: 2.6e5, unit: Pa}, nu: 0.3}\n"
    values = read_material(material_file(tmp_path, text)).values
    assert values == pytest.approx({"mu": 1e5, "lam": 1.5e5}, rel=1e-12)


GOOD = HEAD + "parameters: {mu: 1.0, lam: 2.0}\n"
MATERIALS = {
    "both pairs": (HEAD + "parameters: {mu: 1.0, lam: 2.0, E: 3.0, nu: 0.3}", "not both"),
    "E alone": (HEAD + "parameters: {E: 3.0, lam: 2.0}", "E alone is given"),
    "nu of 0.5": (HEAD + "parameters: {E: 3.0, nu: 0.5}", "nu between -1 and 0.5"),
    "one missing": (HEAD + "parameters: {mu: 1.0}", "fixed-corotated needs a value for lam"),
    "unit": (HEAD + "parameters: {mu: {value: 1.0, unit: kPa}, lam: 2.0}", "mu: the unit is Pa"),
    "E's unit": (HEAD + "parameters: {E: {value: 1.0, unit: MPa}, nu: 0.3}", "E: the unit is Pa"),
    "unknown parameter": (HEAD + "parameters: {mu: 1.0, lam: 2.0, eta: 3.0}", "no parameter 'eta'"),
    "unknown entry": (GOOD + "colour: red", "unknown entries colour"),
    "NaN": (HEAD + "parameters: {mu: .nan, lam: 2.0}", "mu: a finite number"),
    "infinite": (HEAD + "parameters: {mu: -.inf, lam: 2.0}", "mu: a finite number"),
    "huge": (HEAD + "parameters: {mu: 1" + "0" * 400 + ", lam: 2.0}", "mu: a finite number"),
    "text": (HEAD + "parameters: {mu: soft, lam: 2.0}", "mu: a finite number"),
    "truth": (HEAD + "parameters: {mu: true, lam: 2.0}", "mu: a finite number"),
    "no value": (HEAD + "parameters: {mu: {unit: Pa}, lam: 2.0}", "mu: a finite number"),
    "parameters": (HEAD + "parameters: [1.0, 2.0]", "'parameters' must map names"),
    "law": (GOOD.replace("fixed-corotated", "rubber"), "unknown law 'rubber'"),
    "no law": (GOOD.replace("law: fixed-corotated", ""), "unknown law"),
    "newer": (GOOD.replace("material: 1", "material: 2"), "is '2'; this release reads version 1"),
    "no version": ("law: fixed-corotated", "no material: form_drake_material: 1 is wanted in it"),
    "list": ("- 1", "a mapping of names to values is wanted, got list"),
    "bare": ("mu", "a mapping of names to values is wanted, got str"),
    "not YAML": ("a: [", "not valid yaml"),
    "date": ("a: 2024-99-99", "not valid yaml"),
    "control": ("a: \x01", "not valid yaml"),
    "python tag": ("a: !!python/object/apply:os.getcwd []", "not valid yaml"),
    "tag": ("a: !thing 1", "not valid yaml"),
    "empty number": (HEAD + "parameters: {mu: !!int '', lam: 2.0}", "line 3: '' is no int"),
    "empty float": (HEAD + "parameters: {mu: !!float '', lam: 2.0}", "line 3: '' is no float"),
    "no truth": (GOOD + "density: !!bool x", "'x' is no bool"),
    "no time": (GOOD + "density: !!timestamp x", "'x' is no timestamp"),
    "key twice": (GOOD + "law: yeoh", "law is given twice in the entries from line 1 on: keep one"),
    "aliases": ("a: &a [1]\nb: *a", "aliases are not read"),
    "density": (GOOD + "density: -1.0", "density: must be positive"),
    "density unit": (GOOD + "density: {value: 1.0, unit: g/cm^3}", "density: the unit is kg/m"),
    "no density": (GOOD + "density: {unit: kg/m^3}", "density: a finite number"),
    "negative": (HEAD + "parameters: {mu: -1.0, lam: 2.0}", "mu: must be positive, got -1.0"),
    "zero": (HEAD + "parameters: {mu: 0.0, lam: 2.0}", "mu: must be positive, got 0.0"),
    "negative E": (HEAD + "parameters: {E: -1.0, nu: 0.3}", "E must be positive"),
    "negative bulk": (
        "form_drake_material: 1\nlaw: weakly-compressible\nparameters: {lam: -1.0}",
        "lam: must be positive",
    ),
    "negative viscosity": (
        "form_drake_material: 1\nlaw: newtonian\nparameters: {eta: -1.0, kappa: 1.0}",
        "eta: must be positive",
    ),
    "steeper than upright": (
        "form_drake_material: 1\nlaw: drucker-prager\nparameters: {mu: 1.0, lam: 2.0, alpha: 0.82}",
        r"alpha: must be below sqrt\(2/3\) = 0.8165, a friction angle of 90 deg, got 0.82",
    ),
    "no derived": (
        GOOD.replace("}", ", Y: {value: 1.0, derived: true}}"),
        "fixed-corotated has no derived 'Y': choose from E, nu, K",
    ),
    "parameter as derived": (
        HEAD + "parameters: {mu: 1.0, lam: {value: 2.0, derived: true}}",
        "needs a value for lam",
    ),
    "derived unit": (
        GOOD.replace("}", ", K: {value: 2.6, unit: kPa, derived: true}}"),
        "K: the unit is Pa",
    ),
    "derived text": (
        GOOD.replace("}", ", K: {value: stiff, derived: true}}"),
        "K: a finite number",
    ),
    "covariance": (GOOD + "covariance: 3", "covariance: "),
    "covariance keys": (GOOD + "covariance: {keys: 3, values: [[1]]}", "covariance: "),
    "covariance of others": (GOOD + "covariance: {keys: [eta], values: [[1]]}", "covariance: "),
    "covariance twice": (GOOD + "covariance: {keys: [mu, mu], values: [[1, 0], [0, 1]]}", "covar"),
    "covariance nested": (GOOD + "covariance: {keys: [[mu]], values: [[1]]}", "covariance: "),
    "covariance ragged": (GOOD + "covariance: {keys: [mu, lam], values: [[1], [1, 2]]}", "covar"),
    "covariance shape": (GOOD + "covariance: {keys: [mu, lam], values: [[1]]}", "covariance: "),
    "covariance NaN": (GOOD + "covariance: {keys: [mu], values: [[.nan]]}", "must be finite"),
    "covariance of none": (
        GOOD + "covariance: {keys: [mu, lam], values: [[1, 5], [5, 1]]}",
        "negative eigenvalues",
    ),
    "covariance negative": (GOOD + "covariance: {keys: [mu], values: [[-1]]}", "not negative"),
    "covariance skew": (
        GOOD + "covariance: {keys: [mu, lam], values: [[1, 0.5], [-0.5, 1]]}",
        "must be symmetric",
    ),
}


@pytest.mark.parametrize("case", MATERIALS)
def test_wrong_materials_are_refused(tmp_path, case):
    text, message = MATERIALS[case]
    refused(material_file(tmp_path, text), message, read_material)


def test_the_material_behind_the_wrong_ones_is_right(tmp_path):
    material = read_material(material_file(tmp_path, GOOD))
    assert material.values == {"mu": 1.0, "lam": 2.0} and material.keys == ()


@pytest.mark.parametrize(
    "law, values",
    [
        ("fixed-corotated", {"mu": 3.0, "lam": -1.0}),
        ("mooney-rivlin", {"C10": 3.0, "C01": -1.0, "kappa": 9.0}),
        ("yeoh", {"C1": 3.0, "C2": -1.0, "C3": -0.5, "kappa": 9.0}),
        ("drucker-prager", {"mu": 3.0, "lam": 1.0, "alpha": 0.816}),
    ],
)
def test_signed_parameters_may_be_negative(tmp_path, law, values):
    Material(LAWS[law], values).write(tmp_path / "a.yaml")
    assert read_material(tmp_path / "a.yaml").values == values


@pytest.mark.parametrize("law", LAWS.values(), ids=lambda law: law.name)
def test_all_other_parameters_are_positive(law):
    values = dict.fromkeys(law.keys, 0.5)
    material = Material(law, values)
    refused_keys = set()
    for key in law.keys:
        try:
            material.changed({key: -1.0})
        except ValueError as error:
            assert str(error) == f"{key}: must be positive, got -1.0"
            refused_keys.add(key)
    signed = {t.key for t in law.terms if t.signed}
    assert refused_keys == set(law.keys) - signed and signed <= {"C01", "C2", "C3", "lam"}


@pytest.mark.parametrize("alpha", [-9.0, -np.sqrt(8 / 3), -0.5, 0.0, np.sqrt(2 / 3), 0.9, 1e9])
def test_an_identified_cone_always_has_an_angle(alpha):
    values = {"mu": 1.0, "lam": 2.0, "alpha": float(alpha)}
    material = Material(LAWS["drucker-prager"], values, None, ("alpha",), np.eye(1))
    angle = material.parameters()["friction_angle"]
    assert np.isfinite([angle.value, angle.std]).all()
    assert abs(angle.value) <= np.pi / 2


@pytest.mark.parametrize(
    ("law", "values", "told"),
    [
        ("fixed-corotated", {"mu": 3.0, "lam": -3.0}, "bulk modulus -1 Pa: must be positive"),
        ("drucker-prager", {"mu": 3.0, "lam": -5.0, "alpha": 0.3}, "bulk modulus -3 Pa"),
        ("mooney-rivlin", {"C10": 1.0, "C01": -3.0, "kappa": 9.0}, "shear modulus -4 Pa"),
    ],
)
def test_a_body_that_gives_way_is_written_and_not_read(tmp_path, law, values, told):
    keys = tuple(values)
    material = Material(LAWS[law], values, 900.0, keys, np.eye(len(keys)))
    material.write(tmp_path / "a.yaml")
    assert "E" not in material.to_json() if values.get("lam") == -3.0 else "E" in material.to_json()
    refused(tmp_path / "a.yaml", told, read_material)


@pytest.mark.parametrize("key", ["E", "nu", "K", "Y"])
@pytest.mark.parametrize("factor", [1.0 + 5e-7, 1.0 + 2e-6, 2.0])
def test_an_edited_derived_value_is_refused(tmp_path, key, factor):
    sample_material().write(tmp_path / "a.yaml")
    value = sample_material().parameters()[key].value
    text = (tmp_path / "a.yaml").read_text()
    assert text.count(repr(float(value))) == 1
    path = material_file(tmp_path, text.replace(repr(float(value)), repr(float(value * factor))))
    if factor < 1.0 + 1e-6:
        assert read_material(path).values == sample_material().values
    elif key == "Y":
        refused(path, "Y: .* is marked as derived.*; change mu, lam, tau_y instead", read_material)
    else:
        refused(path, f"{key}: .*state E and nu instead of mu and lam", read_material)


def test_binary_and_large_texts_are_refused(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xff\xfe\x00" * 10)
    refused(path, "not a text file", read_material)
    path.write_bytes(b"#" * 5_000_000)
    refused(path, "larger than 4 MB", read_material)


def test_a_failed_material_write_leaves_the_old_one(tmp_path):
    sample_material().write(tmp_path / "a.yaml")
    old = (tmp_path / "a.yaml").read_bytes()
    broken = replace(sample_material(), density="heavy")
    with pytest.raises(ValueError):
        broken.write(tmp_path / "a.yaml")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.yaml", old)]
