"""An identified elastic material as Drake's own finite element material."""

from pydrake.multibody.fem import DeformableBodyConfig, MaterialModel

from form_drake.material import Material

MODELS = {
    "fixed-corotated": MaterialModel.kCorotated,
    "neo-hookean": MaterialModel.kNeoHookean,
}


def deformable_config(material: Material) -> DeformableBodyConfig:
    """Drake's config with the material's stiffness and density; it has no damping.

    ``fixed-corotated`` is Drake's corotated model; ``neo-hookean`` agrees with Drake's at small
    strain, its volumetric energy differs.

    Raises:
        ValueError: a law that Drake has no model of, effects, which it would leave out, or no density.
    """
    if material.law.name not in MODELS:
        raise ValueError(
            f"Drake has no deformable model of {material.law.name}; allowed are {', '.join(MODELS)}"
        )
    if material.effects:
        ids = ", ".join(one.id for one in material.effects)
        raise ValueError(
            f"Drake's deformable bodies have no {ids}: give the material without effects"
        )
    if material.density is None:
        raise ValueError("the material states no density, which Drake's deformable bodies need")
    moduli = material.parameters()
    config = DeformableBodyConfig()
    config.set_youngs_modulus(moduli["E"].value)
    config.set_poissons_ratio(moduli["nu"].value)
    config.set_mass_density(material.density)
    config.set_material_model(MODELS[material.law.name])
    return config
