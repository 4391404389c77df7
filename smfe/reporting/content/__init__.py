"""What a folder of results holds, in words, tables and looks: everything before anything is drawn."""
