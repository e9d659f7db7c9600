"""Evaluates ground-truth boxes as a detection result, with nuscenes-devkit: detection_of_truth.py DATASET OUT [EMPTY..]

Boxes, attributes and velocities of the result are those that the devkit computes for the ground truth. Samples with
tokens EMPTY get no boxes. Prints scores as JSON. Runs in the environment of the devkit.
"""

import json
import sys
from collections import Counter
from pathlib import Path

from nuscenes import NuScenes
from nuscenes.eval.common.config import config_factory
from nuscenes.eval.common.loaders import load_gt_of_sample_tokens
from nuscenes.eval.detection.data_classes import DetectionBox
from nuscenes.eval.detection.evaluate import DetectionEval


def main(dataset, out, *empty):
    version = json.loads((Path(dataset) / "generated.json").read_text())["version"]
    nusc = NuScenes(version=version, dataroot=dataset, verbose=False)
    tokens = [sample["token"] for sample in nusc.sample]
    truth = load_gt_of_sample_tokens(nusc, tokens, DetectionBox)
    results = {
        token: [{**box.serialize(), "detection_score": 1.0} for box in truth[token] if token not in empty]
        for token in tokens
    }
    path = Path(out) / "results.json"
    path.write_text(json.dumps({"meta": {}, "results": results}, default=list))
    # The split of splits.json, which the copy of generated samples has.
    evaluation = DetectionEval(nusc, config_factory("detection_cvpr_2019"), str(path), "generated", out, verbose=False)
    metrics = evaluation.evaluate()[0].serialize()
    boxes = Counter(box.detection_name for box in evaluation.gt_boxes.all)
    scores = {name: metrics[name] for name in ("mean_ap", "nd_score", "mean_dist_aps", "label_tp_errors")}
    print(json.dumps({"samples": evaluation.sample_tokens, "boxes": boxes, **scores}))


if __name__ == "__main__":
    main(*sys.argv[1:])
