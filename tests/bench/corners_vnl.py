"""Prints the corners that stuv keeps with a recording as mrcal's corners.vnl.

    corners_vnl.py REC PICTURES

PICTURES: the folder that the recording's frames lie in, named Position{set}_Camera{camera}.png.
"""
import glob, json, os, sys

rec, pictures = sys.argv[1:3]
print('# filename x y level')
for file in sorted(glob.glob(os.path.join(rec, 'corners', '*', '*', '*.json'))):
    folder, camera = os.path.split(file)
    picture = os.path.join(pictures, 'Position%s_Camera%s.png' % (os.path.basename(folder), camera[:-5]))
    kept = json.load(open(file))
    columns, rows = map(int, kept['board'].split(':')[1].split('x'))
    # The level is a weight of 2^-level: all that was found counts the same.
    seen = {int(corner[0]): corner for corner in kept['corners']}
    for k in range(columns * rows if seen else 1):
        print(picture, *(('%.6f' % seen[k][1], '%.6f' % seen[k][2], '0') if k in seen else ('-', '-', '-')))
