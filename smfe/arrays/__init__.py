"""Arrays and objects of one's own, as records, compliances and campaigns that the rest of the package takes."""
