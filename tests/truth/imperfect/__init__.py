"""Campaign folders of machines as they stand in workshops: healthy, or with something hidden in them.

Each campaign, a healthy one too, draws the ordinary imperfections: hits that lean, sensors calibrated within 1 %,
mounted within 1 degree and with 1 % of cross-talk, recorders whose clocks differ by 20 us, mains hum with harmonics,
quantised readings, filters, declared numbers that are right within their tolerances only. Nothing of the packages is
imported.

``python -m truth.imperfect FAMILY SEED WHAT FOLDER`` writes one, where WHAT is "healthy", "effect" (one, drawn),
"pair", "outside", or names of effects joined by "+".
"""
