"""Modal fit of a compliance."""
