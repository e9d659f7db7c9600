//! Denoisers that answer wrongly, die or hang, and windows that do not fit them.

use pskel_testing::shared::assert_error_contains;

use super::*;

#[test]
fn bad_answers_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let said = |tensor: &str| format!("say(prediction=({tensor}))");
    let floats = |at: usize, value: &str| {
        let values = format!("array.array('f', [float('{value}') if i == {at} else 0 for i in range(144)])");
        said(&format!("'F32', SHAPE, {values}.tobytes()"))
    };
    let raw = |bytes: &str| format!("out.write({bytes})\nout.flush()");
    let cases = [
        (
            said("'I64', SHAPE, bytes(8 * 144)"),
            "`prediction` as F32, which its hello says, from the denoiser, found I64",
        ),
        (said("'F64', SHAPE, bytes(8 * 144)"), "found F64"),
        (said("'F16', SHAPE, bytes(2 * 144)"), "found F16"),
        (
            said("'F32', [4, 2, 3, 3, 2], bytes(4 * 144)"),
            "`prediction` of [4, 2, 3, 2, 3] from the denoiser, found [4, 2, 3, 3, 2]",
        ),
        (said("'F32', SHAPE[1:], bytes(4 * 36)"), "found [2, 3, 2, 3]"),
        (said("'F32', [0], b''"), "found [0]"),
        (said("'F32', SHAPE, bytes(4 * 143)"), "a safetensors file from the denoiser, found"),
        (
            "say(noise=('F32', SHAPE, bytes(4 * 144)))".to_owned(),
            "a tensor `prediction` from the denoiser, found noise",
        ),
        ("say()".to_owned(), "a tensor `prediction` from the denoiser, found none"),
        ("say({'call': '7'})".to_owned(), "an answer to `call` \"0\" from the denoiser, found \"7\""),
        (floats(40, "nan"), "finite values for frame 1 of the window from the denoiser, found NaN"),
        (floats(143, "-inf"), "finite values for frame 3 of the window from the denoiser, found -inf"),
        (
            raw("b'step 1 of 50\\n'"),
            "a message of at most 1073741824 bytes from the denoiser, found a length of",
        ),
        (raw("b'step 1 of 50\\n'"), "bytes \"step 1 o\""),
        (raw("struct.pack('<Q', 1 << 60)"), "found a length of 1152921504606846976"),
        (raw("struct.pack('<Q', (1 << 30) + 1)"), "found a length of 1073741825"),
        (raw("struct.pack('<Q', 0)"), "found 0 bytes: header too small"),
        (raw("struct.pack('<QQ', 24, 16) + b'no header at all'"), "found 24 bytes: invalid JSON in header"),
        (raw("struct.pack('<QQ', 24, 99) + b'x' * 16"), "invalid header length"),
        (
            raw("struct.pack('<QQ', 9000, 8992) + b'[\"' + b'x' * 8990"),
            "a safetensors file from the denoiser",
        ),
    ];
    for (answer, part) in cases {
        let address = script(folder.path(), &format!("see()\nsay(HELLO)\nsee()\n{answer}\ntime.sleep(600)"));
        let error = fails(address.clone(), PATIENT_S);
        assert!(matches!(error, PeerError::Answer { .. }), "{error}");
        assert_error_contains(&error, part, &address);
    }
}

#[test]
fn bad_hellos_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    for (answer, part) in [
        (
            "say(HELLO | {'version': '2'})",
            "of `version` \"1\" from the denoiser, found `protocol` \"pskel-denoiser\" of `version` \"2\"",
        ),
        ("say(HELLO | {'protocol': 'pskel-planner'})", "found `protocol` \"pskel-planner\""),
        ("say()", "found `protocol` none of `version` none"),
        ("say(HELLO | {'latent_shape': '3,3,2,3'})", "with V = 2 from the denoiser, found \"3,3,2,3\""),
        ("say(HELLO | {'latent_shape': '2,3,2'})", "found \"2,3,2\""),
        ("say(HELLO | {'latent_shape': '2,3,65536,65536'})", "of at most 33554432 values in a window of 4"),
        ("del HELLO['latent_shape']\nsay(HELLO)", "found none"),
        (
            "say(HELLO | {'dtype': 'I64'})",
            "`dtype` \"F32\", \"F16\" or \"BF16\" from the denoiser, found \"I64\"",
        ),
        ("print('loading the model ...', flush=True)", "bytes \"loading \""),
    ] {
        let address = script(folder.path(), &format!("see()\n{answer}\ntime.sleep(600)"));
        let error = refused(address.clone(), PATIENT_S);
        assert!(matches!(error, PeerError::Answer { .. }), "{error}");
        assert_error_contains(&error, part, &address);
    }
    for timeout_s in [0.0, f64::NAN] {
        assert!(matches!(refused(example(), timeout_s), PeerError::Timeout { .. }));
    }
    let hangs = refused(command("exec sleep 600".into()), 0.5);
    assert!(matches!(hangs, PeerError::Silent { .. }), "{hangs}");
    for (lines, part) in [("exit 3", "found its end (exit status: 3)"), ("/nowhere/denoiser", "127")] {
        let gone = refused(command(lines.into()), PATIENT_S).to_string();
        assert!(gone.contains(part) && gone.ends_with(lines), "{gone}");
    }
    let sampler = SamplerOptions::Ddim { prediction: Prediction::Sample };
    let spec = PeerSpec { address: example(), timeout_s: PATIENT_S };
    let cannot = ProcessDenoiser::start(&spec, &GenerateOptions { sampler, ..options() }, &rig(), SIZE);
    let cannot = cannot.err().unwrap().to_string();
    assert!(cannot.contains("found its end (exit status: 1)"), "{cannot}");
    let nobody = PeerAddress::Unix(folder.path().join("nobody"));
    assert!(matches!(refused(nobody, 0.2), PeerError::Io { verb: "reach", .. }));
}

#[test]
fn denoisers_that_hang_or_die_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let after_hello = |lines: &str| script(folder.path(), &format!("see()\nsay(HELLO)\n{lines}"));
    // A call is longer than a pipe's buffer, so in the second case it cannot be sent.
    for hangs in [
        "see()\ntime.sleep(600)",
        "time.sleep(600)",
        "see()\nout.write(struct.pack('<Q', 1000) + bytes(100))\nout.flush()\ntime.sleep(600)",
    ] {
        let error = fails(after_hello(hangs), HASTY_S);
        assert!(matches!(error, PeerError::Silent { .. }), "{error}");
        assert!(
            error.to_string().contains("of the denoiser within 4 s, found none: exec python3"),
            "{error}"
        );
    }
    for (dies, part) in [
        ("see()\nos.kill(os.getpid(), 9)", "found its end (signal: 9 (SIGKILL))"),
        ("sys.exit(5)", "found its end (exit status: 5)"),
        ("see()\nos.close(1)\ntime.sleep(600)", "found its end: exec python3"),
        (
            "see()\nout.write(struct.pack('<Q', 1000) + bytes(100))\nout.flush()\nos._exit(6)",
            "found its end after 108 of 1008 bytes (exit status: 6)",
        ),
        ("see()\nout.write(bytes(3))\nout.flush()\nos._exit(7)", "after 3 of 8 bytes (exit status: 7)"),
    ] {
        let address = after_hello(dies);
        let error = fails(address.clone(), PATIENT_S);
        assert!(matches!(error, PeerError::Gone { .. }), "{error}");
        assert_error_contains(&error, part, &address);
    }
}

/// A surplus answer is rejected on arrival, or as the answer to the next call, because its number does not
/// match.
#[test]
fn unsolicited_answers_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let answer = "say({'call': '0'}, prediction=('F32', SHAPE, bytes(576)))";
    let lines = format!("see()\nsay(HELLO)\nsee()\n{answer}\n{answer}\ntime.sleep(600)");
    let mut denoiser = start(script(folder.path(), &lines), PATIENT_S).unwrap();
    predict(&mut denoiser).unwrap();
    let message = predict(&mut denoiser).unwrap_err().to_string();
    let unasked = message.contains("no unsolicited message");
    assert!(unasked || message.contains("an answer to `call` \"1\""), "{message}");
}

#[test]
fn windows_other_than_declared_are_not_sent() {
    use pskel_generate::Denoiser;
    let mut denoiser = start(example(), PATIENT_S).unwrap();
    let good = (Latent::filled(SHAPE, 0.0), conditions(0));
    let thin = Latent::filled(LatentShape { channels: 1, ..SHAPE }, 0.0);
    let narrow = FrameConditions { size: ImageSize { width: 23, ..SIZE }, ..conditions(0) };
    let blind = FrameConditions { cameras: Vec::new(), ..conditions(0) };
    let short = FrameConditions { bins: Vec::new(), ..conditions(0) };
    let last = |latent: &Latent, condition: &FrameConditions| (latent.clone(), condition.clone());
    let mut error = |count: usize, (latent, condition): (Latent, FrameConditions)| {
        let level = Level { timestep: 1.0, sigma: 0.1 };
        let mut window =
            vec![Frame { latent: &good.0, level, is_reference: false, condition: &good.1 }; count];
        window.push(Frame { latent: &latent, level, is_reference: false, condition: &condition });
        denoiser.predict(&window).map_err(|error| error.to_string())
    };
    for (count, frame, said) in [
        (2, good.clone(), "expected a window of 4 frames, found 3"),
        (3, last(&thin, &good.1), "latents of 2x3x2x3 for frame 3 of the window, found 2x1x2x3"),
        (3, last(&good.0, &narrow), "frame 3 of the window, found 2 of"),
        (3, last(&good.0, &blind), "frame 3 of the window, found 0 of"),
        (3, last(&good.0, &short), "24, not whole"),
    ] {
        let message = error(count, frame).unwrap_err();
        assert!(message.contains(said), "{message}");
    }
    // Nothing was sent: the process is still running.
    assert_eq!(error(3, good.clone()).unwrap().len(), 4);
}

/// After any failure, a new process generates the same frames as without it.
#[test]
fn a_generator_continues_with_a_new_process() {
    let folder = tempfile::tempdir().unwrap();
    let drive = drive(3);
    let (frames, caches) =
        drive.run(&mut drive.generator(start(example(), PATIENT_S).unwrap(), NOISE, options()));
    for (happens, timeout_s, part) in [
        ("os.kill(os.getpid(), 9)", PATIENT_S, "SIGKILL"),
        ("time.sleep(600)", HASTY_S, "within 4 s"),
        ("return array.array('f', [float('nan')] * 144)", PATIENT_S, "finite values for frame 0"),
        ("return array.array('d', [0.0] * 144)", PATIENT_S, "a safetensors file"),
    ] {
        // In the fourth of eight calls for the second frame.
        let lines = format!(
            "inner, calls = denoiser.predict, []\ndef predict(tensors):\n    calls.append(0)\n    \
             if len(calls) == 12:\n        {happens}\n    return inner(tensors)\n\
             denoiser.predict = predict\ndenoiser.serve(source, out)"
        );
        let fake = start(script(folder.path(), &lines), timeout_s).unwrap();
        let mut generator = drive.generator(fake, NOISE, options());
        let first = generator.step(drive.committed[3].clone(), &drive.forecasts[0]).unwrap();
        assert_eq!((&first, generator.cache()), (&frames[0], &caches[0]));
        for said in [part, "found its end"] {
            let error = generator.step(drive.committed[4].clone(), &drive.forecasts[1]).unwrap_err();
            assert!(matches!(error, GenerateError::Denoiser { frame: 4, .. }), "{error}");
            assert!(error.to_string().contains(said), "{error}");
            assert_eq!(generator.cache(), &caches[0]);
        }
        let fresh = start(example(), PATIENT_S).unwrap();
        let shown = drive.committed[1..4].to_vec();
        let resumed = Generator::resume(fresh, NOISE, options(), generator.cache().clone(), shown);
        assert_eq!(drive.run(&mut resumed.unwrap()), (frames[1..].to_vec(), caches[1..].to_vec()));
    }
}
