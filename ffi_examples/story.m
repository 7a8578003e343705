% The story in MATLAB: two images per view, calibrate, print sheet and sigmas, map points.
%
%   story(library, header, rig, images, saved)
%   story('/usr/local/lib/libspivcal.so.1', '/usr/local/include/spivcal.h', 'rig.toml', 'images', 'calibration.json')
%
% MATLAB needs a C compiler once, to read the header (mex -setup C). Handles are uint64; do not let them become doubles in
% arithmetic (they stay below 2^52, so that even that would not change them).
function story(library, header, rig_file, images, saved)
    alias = 'spivcal';
    if ~libisloaded(alias)
        loadlibrary(library, header, 'alias', alias);
    end

    % Constants of spivcal.h.
    COUNT_CAMERAS = 211; CAMERA_F_PX = 301; CAMERA_BETA_RAD = 306; BASELINE_MM = 401;
    SHEET_DISTANCE_MM = 411; SHEET_A_PER_MM = 415; SHEET_ANGLE_TO_BASELINE_DEG = 421;
    TEXT_HEADLINE = 604; WARNING_FLAGGED = 1;

    context = libpointer('uint64Ptr', uint64(0));
    must(alias, calllib(alias, 'spivcal_context_create', int32(0), context), uint64(0));
    context = context.Value;
    % Whatever happens from here on: jobs end and memory is given back, then the library is unloaded.
    finish = onCleanup(@() close_all(alias, context));

    rig = libpointer('uint64Ptr', uint64(0));
    must(alias, calllib(alias, 'spivcal_rig_load', context, rig_file, images, rig), context);
    rig = rig.Value;

    % Images from memory: MATLAB keeps columns together, the library wants rows, so the matrix is transposed.
    sides = {'left', 'right'};
    for camera = 0:1
        grey = imread(fullfile(images, ['v01_' sides{camera + 1} '.png']))';
        handle = libpointer('uint64Ptr', uint64(0));
        [width, height] = size(grey);
        if isa(grey, 'uint16')
            make = 'spivcal_image_create_u16'; bytes = 2;
        else
            make = 'spivcal_image_create_u8'; bytes = 1;
        end
        must(alias, calllib(alias, make, context, grey(:), uint32(width), uint32(height), uint64(width * bytes), handle), ...
             context);
        must(alias, calllib(alias, 'spivcal_rig_set_image', rig, uint64(0), uint64(camera), handle.Value), rig);
    end

    calibration = libpointer('uint64Ptr', uint64(0));
    status = calllib(alias, 'spivcal_calibration_run', rig, calibration);
    must(alias, status, rig);
    calibration = calibration.Value;
    [~, headline] = calllib(alias, 'spivcal_calibration_text_copy', calibration, int32(TEXT_HEADLINE), uint64(0), ...
                            blanks(500), uint64(500), uint64(0));
    disp(headline);
    fprintf('flagged %d\n', status == WARNING_FLAGGED);

    cameras = libpointer('uint64Ptr', uint64(0));
    must(alias, calllib(alias, 'spivcal_calibration_count', calibration, int32(COUNT_CAMERAS), cameras), calibration);
    for camera = 0:double(cameras.Value) - 1
        show(alias, calibration, 'f_px', CAMERA_F_PX, camera);
        show(alias, calibration, 'beta_rad', CAMERA_BETA_RAD, camera);
    end
    show(alias, calibration, 'baseline_mm', BASELINE_MM, 0);
    show(alias, calibration, 'distance_mm', SHEET_DISTANCE_MM, 0);
    for i = 0:2
        show(alias, calibration, [char('a' + i) '_per_mm'], SHEET_A_PER_MM + i, 0);
    end
    show(alias, calibration, 'angle_to_baseline_deg', SHEET_ANGLE_TO_BASELINE_DEG, 0);

    must(alias, calllib(alias, 'spivcal_calibration_save', calibration, saved), calibration);
    u = [100 511.5 900]; v = [80 383.5 700];
    x = libpointer('doublePtr', zeros(1, 3));
    y = libpointer('doublePtr', zeros(1, 3));
    point_status = libpointer('int32Ptr', int32(zeros(1, 3)));
    must(alias, calllib(alias, 'spivcal_calibration_sheet_from_pixel', calibration, uint64(0), uint64(3), u, v, x, y, ...
                        point_status), calibration);
    fprintf('map %.17g %.17g\n', [x.Value; y.Value]);
end

function show(alias, calibration, name, key, index)
    value = libpointer('doublePtr', 0);
    sigma = libpointer('doublePtr', 0);
    must(alias, calllib(alias, 'spivcal_calibration_number', calibration, int32(key), uint64(index), value, sigma), calibration);
    fprintf('%s %.17g %.17g\n', name, value.Value, sigma.Value);
end

% Ends the script where a call failed; `owner` is the handle that it was given first.
function must(alias, status, owner)
    if status < 0
        error('spivcal:call', '%s (status %d)', error_words(alias, owner, status), status);
    end
end

function words = error_words(alias, owner, status)
    [~, words] = calllib(alias, 'spivcal_error_text', owner, blanks(2000), uint64(2000), uint64(0));
    if isempty(strtrim(words))
        [~, words] = calllib(alias, 'spivcal_status_text', int32(status), blanks(2000), uint64(2000), uint64(0));
    end
end

function close_all(alias, context)
    calllib(alias, 'spivcal_context_destroy', context);
    unloadlibrary(alias);
end
