"""The sections of the page, one module each: ``section(draft)`` returns what its template of the same name takes.

A section that has nothing to say returns an empty dictionary and stands neither on the page nor among its links.
"""
