$lines

    int sound = 1;
    for (int i = 0; i < $n; i++)
        sound = sound && isfinite(asked[i]);
$check    if (sound) {
$store    }
    for (int i = 0; i < $size; i++)
        $output[i] = self->$stored[i];
    return !sound;
