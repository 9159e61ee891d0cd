# Two generated pairs with a label map, and one with a displacement field that is wrong in one place.
depthcli sample --registration --count 2 --output volumes --quiet
mkdir mine
python - <<'END'
import shutil
from pathlib import Path

import numpy as np
import SimpleITK as sitk

for pair in Path("volumes").glob("pair_*"):
    mask = sitk.ReadImage(str(pair / "mask.nii.gz"))
    labels = sitk.GetArrayFromImage(mask)
    labels[labels.shape[0] // 2 :] *= 2
    organs = sitk.GetImageFromArray(labels)
    organs.CopyInformation(mask)
    sitk.WriteImage(organs, str(pair / "mask_organs.nii.gz"))
fixed = sitk.ReadImage("volumes/pair_0/fixed.nii.gz", sitk.sitkFloat32)
spline = sitk.BSplineTransformInitializer(fixed, (4, 4, 4))
spline.SetParameters(np.random.default_rng(3).uniform(-6, 6, len(spline.GetParameters())).tolist())
grid = fixed.GetSize(), fixed.GetOrigin(), fixed.GetSpacing(), fixed.GetDirection()
away = sitk.TransformToDisplacementField(spline, sitk.sitkVectorFloat32, *grid)
back = sitk.GetArrayFromImage(sitk.InvertDisplacementField(away, 50))
moving = sitk.Resample(fixed, sitk.DisplacementFieldTransform(sitk.Cast(away, sitk.sitkVectorFloat64)))
z, y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in reversed(fixed.GetSize())), indexing="ij")
bump = 6 * np.exp(-((x - 0.3) ** 2 + (y + 0.2) ** 2 + z**2) / 0.1)
found = sitk.GetImageFromArray((back + bump[..., None] * [1, 0.5, 0]).astype(np.float32), isVector=True)
found.CopyInformation(fixed)
for name, image in (("fixed", fixed), ("moving", moving), ("displacement", found)):
    sitk.WriteImage(image, f"mine/{name}.nii.gz")
shutil.copy("volumes/pair_0/mask.nii.gz", "mine/mask.nii.gz")
END
