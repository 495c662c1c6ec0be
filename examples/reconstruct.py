"""Reconstruct a hidden object from pictures of the wall: files in, picture out."""

import sys

import nlosoptics as nlos
from nlosoptics import imaging, inverse, reconstructing, views

scene_file, *pictures = sys.argv[1:]
scene = nlos.Scene.load(scene_file)
print(nlos.limits.feasibility(scene).verdict)
taken = imaging.camera_image(pictures, shape=scene.camera.shape)  # dark=, flat=
model = reconstructing.known_model(scene)
veil = imaging.diffuse_background(scene)  # shape of the wall's diffuse light
image = inverse.Measurement(taken.values, masked=taken.masked, background_shape=veil)
found = inverse.tv_deconvolve(image, model)
print(f"{found.status}, residual {found.score:.2f} of the noise")
views.save(views.reconstruction(found), "object.png")
