//! Conditions that are sent once.

use point_skeleton::conditions::tensor::POINT_CHANNELS;
use pskel_generate::Denoiser;
use safetensors::Dtype;

use super::*;

/// Keeps each message as a file, and answers with zeros.
const KEEP: &str = "
see()
say(HELLO | {'frames': 'true'})
for call in range(100):
    if not (length := source.read(8)):
        break
    message = source.read(*struct.unpack('<Q', length))
    open(f'{FOLDER}/call{call}', 'wb').write(message)
    say(prediction=('F32', SHAPE, bytes(4 * 144)))
";

#[test]
fn conditions_are_sent_once_and_exactly() {
    let folder = tempfile::tempdir().unwrap();
    let lines = format!("FOLDER = {:?}\n{KEEP}", folder.path());
    let mut denoiser = start(script(folder.path(), &lines), PATIENT_S).unwrap();
    let all: Vec<FrameConditions> = (0..6).map(conditions).collect();
    let latent = Latent::filled(SHAPE, 0.5);
    let mut call = |positions: [usize; 4]| {
        let frame = |position: usize| Frame {
            latent: &latent,
            level: Level { timestep: 500.0, sigma: 0.5 },
            is_reference: position == 0,
            condition: &all[position],
        };
        denoiser.predict(&positions.map(frame)).unwrap();
    };
    // The first frame twice; the same again; one frame on; a frame that was forgotten.
    let calls = [[0, 0, 1, 2], [0, 0, 1, 2], [1, 2, 3, 4], [0, 1, 2, 5]];
    calls.into_iter().for_each(&mut call);
    let mut seen = std::collections::BTreeMap::new();
    for (number, (positions, new)) in calls.iter().zip([vec![0, 1, 2], vec![], vec![3, 4], vec![0, 5]]).enumerate()
    {
        let message = std::fs::read(folder.path().join(format!("call{number}"))).unwrap();
        let (_, head) = SafeTensors::read_metadata(&message).unwrap();
        let texts = head.metadata().clone().unwrap();
        let list = |name: &str| -> Vec<u64> { serde_json::from_str(&texts[name]).unwrap() };
        let (numbers, sent) = (list("frames"), list("new"));
        assert_eq!((numbers.len(), sent.len()), (4, new.len()), "call {number}");
        seen.extend(sent.iter().copied().zip(new.iter().copied()));
        assert_eq!(numbers.iter().map(|number| seen[number]).collect::<Vec<usize>>(), positions);
        assert_eq!(serde_json::from_str::<Vec<serde_json::Value>>(&texts["prompts"]).unwrap().len(), 4);
        let tensors = SafeTensors::deserialize(&message).unwrap();
        assert!(tensors.tensor("points").is_err() && tensors.tensor("latents").is_ok());
        if new.is_empty() {
            assert!(tensors.tensor("color").is_err());
            continue;
        }
        let bytes = |name: &str, of: fn(&FrameConditions) -> &Vec<[u8; 3]>| {
            let tensor = tensors.tensor(name).unwrap();
            assert_eq!((tensor.dtype(), tensor.shape()), (Dtype::U8, &[new.len(), VIEWS, 16, 24, 3][..]));
            assert_eq!(tensor.data(), new.iter().map(|i| of(&all[*i]).as_flattened()).collect::<Vec<_>>().concat());
        };
        bytes("color", |frame| &frame.color);
        bytes("boxes", |frame| &frame.boxes);
        bytes("map", |frame| &frame.map);
        // The depth channels of the bins are those of the points.
        let (shape, values) = tensor(&tensors, "depth_values");
        assert_eq!(shape, [POINT_CHANNELS - 3, 257]);
        let bins = tensors.tensor("bins").unwrap();
        assert_eq!((bins.dtype(), bins.shape()), (Dtype::U16, &[new.len(), VIEWS, 16, 24][..]));
        let mut bins = bins.data().chunks(2).map(|bin| usize::from(u16::from_le_bytes([bin[0], bin[1]])));
        for frame in new.iter().map(|i| &all[*i]) {
            let (points, pixels) = (frame.points(), SIZE.pixels());
            for view in 0..VIEWS {
                for pixel in 0..pixels {
                    let bin = bins.next().unwrap();
                    for channel in 3..POINT_CHANNELS {
                        let point = points[(view * POINT_CHANNELS + channel) * pixels + pixel];
                        assert_eq!(values[(channel - 3) * 257 + bin], point);
                    }
                }
            }
        }
        assert_eq!(tensor(&tensors, "action").1, new.iter().flat_map(|i| all[*i].action).collect::<Vec<f32>>());
        let cameras = new.iter().flat_map(|i| all[*i].cameras.as_flattened().iter().copied());
        assert_eq!(tensor(&tensors, "cameras").1, cameras.collect::<Vec<f32>>());
    }
}
