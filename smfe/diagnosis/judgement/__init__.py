"""From fits to a finding: the search for causes, what was declared, what matters, the verdict, the next experiment."""
