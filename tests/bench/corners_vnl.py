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
    for corner in json.load(open(file)).get('corners_px', []) or [None]:
        print(picture, *(('%.6f' % corner[0], '%.6f' % corner[1], '0') if corner else ('-', '-', '-')))
