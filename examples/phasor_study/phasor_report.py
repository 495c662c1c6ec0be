def write(lines, folder, setting): pass
