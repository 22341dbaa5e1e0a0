"""What ParaView does with a result, as a script: its reader, a frame, colours, a picture.

    python examples/vtk_picture.py sphere-to-bunny.vtkhdf bunny.png --up z

Needs VTK 9.3 or newer (pip install vtk) and no display.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import vtkmodules.vtkRenderingFreeType
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  the library looks for its parts at run time
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkDataObject
from vtkmodules.vtkFiltersCore import vtkGlyph3D
from vtkmodules.vtkFiltersSources import vtkSphereSource
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOImage import vtkPNGWriter
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkColorTransferFunction,
    vtkPolyDataMapper,
    vtkRenderer,
    vtkRenderWindow,
    vtkTextActor,
    vtkTextProperty,
    vtkWindowToImageFilter,
)


def main() -> None:
    """Read the command line and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("result", type=Path, help="a .vtkhdf file")
    parser.add_argument("picture", type=Path, help="the .png file to write")
    parser.add_argument("--frame", type=int, default=-1)
    parser.add_argument("--color", default="det_f", help="an array of the particles")
    parser.add_argument("--label", help="what stands at the colours; the array's name by default")
    parser.add_argument("--title", default="", help="what stands above the picture")
    parser.add_argument(
        "--middle", type=float, default=1.0, help="value in the middle of the colours"
    )
    parser.add_argument("--radius", type=float, default=0.18, help="of a particle, in grid units")
    parser.add_argument("--up", choices=("y", "z"), default="y")
    arguments = parser.parse_args()

    reader = vtkHDFReader()
    reader.SetFileName(str(arguments.result))
    reader.UpdateInformation()
    reader.SetStep(arguments.frame % reader.GetNumberOfSteps())
    reader.Update()
    particles = reader.GetOutput()
    values = particles.GetPointData().GetArray(arguments.color)

    ball = vtkSphereSource(radius=arguments.radius, theta_resolution=12, phi_resolution=8)
    glyphs = vtkGlyph3D()
    glyphs.SetInputData(particles)
    glyphs.SetSourceConnection(ball.GetOutputPort())
    glyphs.ScalingOff()
    mapper = vtkPolyDataMapper()
    mapper.SetInputConnection(glyphs.GetOutputPort())
    renderer = vtkRenderer()
    renderer.SetBackground(1, 1, 1)
    if values is not None:
        reach = np.quantile(np.abs(vtk_to_numpy(values) - arguments.middle), 0.99)
        colors = vtkColorTransferFunction()  # ParaView's cool to warm
        colors.SetColorSpaceToDiverging()
        colors.AddRGBPoint(arguments.middle - reach, 0.23, 0.30, 0.75)
        colors.AddRGBPoint(arguments.middle, 0.87, 0.87, 0.87)
        colors.AddRGBPoint(arguments.middle + reach, 0.71, 0.02, 0.15)
        mapper.SetLookupTable(colors)
        glyphs.SetInputArrayToProcess(
            0, 0, 0, vtkDataObject.FIELD_ASSOCIATION_POINTS, arguments.color
        )
        glyphs.SetColorModeToColorByScalar()
        label = arguments.label or arguments.color
        bar = vtkScalarBarActor(lookup_table=colors, title=label, number_of_labels=5)
        bar.SetLabelFormat("%.2f")
        bar.SetUnconstrainedFontSize(True)
        bar.SetPosition(0.86, 0.25)
        bar.SetWidth(0.07)
        bar.SetHeight(0.5)
        plain(bar.GetTitleTextProperty())
        plain(bar.GetLabelTextProperty())
        renderer.AddActor(bar)
    title = vtkTextActor(input=arguments.title)
    plain(title.GetTextProperty())
    title.SetPosition(24, 684)
    renderer.AddActor(title)
    actor = vtkActor()
    actor.SetMapper(mapper)
    renderer.AddActor(actor)
    camera = renderer.GetActiveCamera()
    camera.SetViewUp(*((0, 1, 0) if arguments.up == "y" else (0, 0, 1)))
    camera.SetPosition(*((0.4, 0.3, 1) if arguments.up == "y" else (1, 0.4, 0.3)))
    renderer.ResetCamera()
    camera.Zoom(1.3)

    window = vtkRenderWindow()
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(4)
    window.SetSize(960, 720)
    window.AddRenderer(renderer)
    window.Render()
    grab = vtkWindowToImageFilter()
    grab.SetInput(window)
    writer = vtkPNGWriter()
    writer.SetFileName(str(arguments.picture))
    writer.SetInputConnection(grab.GetOutputPort())
    writer.Write()
    assert arguments.picture.stat().st_size > 0, "The picture should be written."


def plain(text: vtkTextProperty) -> None:
    """Dark upright letters."""
    text.SetColor(0.1, 0.1, 0.1)
    text.SetFontSize(20)
    text.ItalicOff()
    text.BoldOff()
    text.ShadowOff()


if __name__ == "__main__":
    main()
