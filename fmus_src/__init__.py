"""Components of the floating wind turbine, written once as equations and exported as FMUs."""
